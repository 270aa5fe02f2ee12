"""`ltm status`: how a running tower is, for a person."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from ltm_ros.cli.tables import print_table

INSTALLED_SITE = Path("/etc/ltm/site.yaml")
STYLES = {"ok": "green", "troubled": "yellow", "silent": "bold red", "missing": "bold red"}


def status(
    site: Annotated[Path, typer.Argument(help="Site file (YAML), with the section `health`.")] = INSTALLED_SITE,
    json_: Annotated[bool, typer.Option("--json", help="Print what the tower says as JSON.")] = False,
) -> None:
    """Ask a running tower how it is. Exit code 0 where all nodes report and all frames come, else 1."""
    import json

    from ltm_core.base.errors import ConfigError
    from ltm_core.site.site_io import load_site
    from ltm_ros.tower.health_client import ask

    config = load_site(site).health
    if config is None:
        raise ConfigError(f"{site}: has no section `health`; add `health: {{}}`, and start the tower again")
    said: dict[str, Any] = ask(config, "/status.json")
    if json_:
        typer.echo(json.dumps(said, indent=2))
    else:
        _print_status(said)
    raise typer.Exit(0 if said["ready"] else 1)


def _print_status(said: Mapping[str, Any]) -> None:
    """Print what `TowerStatus.as_dict` returns."""
    from rich.console import Console
    from rich.markup import escape

    console = Console()
    wrong = said["wrong"]
    console.print(
        f"[bold]{escape(said['site'])}[/]: {'all is well' if not wrong else f'{len(wrong)} things are wrong'}"
    )
    for line in wrong:
        console.print(f"  - {escape(line)}", style="yellow", highlight=False)
    cameras = []
    for one in said["cameras"]:
        dropped = ", ".join(f"{cause} {count}" for cause, count in sorted(one["dropped"].items()))
        cells = (
            one["name"],
            _seconds(one["frame_age_s"], " ago"),
            str(one["frames_in"]),
            str(one["finished"]),
            dropped,
            _seconds(one["latency_s"]),
            one["pose"],
        )
        cameras.append(tuple(map(escape, cells)))
    nodes = []
    for one in said["nodes"]:
        values = one["values"]
        work = values.get("work_p95_ms")
        nodes.append(
            (
                escape(one["name"]),
                f"[{STYLES[one['state']]}]{one['state']}[/]",
                escape(values.get("frames_in", "")),
                escape(values.get("frames_out", "")),
                escape(values.get("dropped", "")),
                escape(f"{work} ms" if work else ""),
                escape(one["said"][:80]),
            )
        )
    columns = ("camera", ">newest frame", ">frames", ">finished", "given up", ">latency", "pose")
    print_table(console, "", columns, cameras)
    print_table(console, "", ("node", "state", ">in", ">out", ">given up", ">work p95", "says"), nodes)
    if (outbox := said["outbox"]) is not None:
        link = "the region's map is there" if outbox["link_up"] else "the region's map cannot be reached"
        console.print(
            escape(
                f"outbox: {outbox['frames']} frames, {outbox['bytes'] / 1e6:.1f} MB, the oldest of "
                f"{outbox['age_s']:.0f} s ago; {link}"
            ),
            highlight=False,
        )
    kept = "; ".join(f"{d['folder']} {d['free'] / 1e9:.1f} of {d['total'] / 1e9:.0f} GB free" for d in said["disks"])
    used = ", ".join(f"{name} {size / 1e6:.0f} MB" for name, size in said["process_memory"].items())
    sync = {True: "kept right", False: "kept right by nothing", None: "not known"}[said["clock"]["synchronised"]]
    console.print(escape(f"clock {sync}, set {said['clock_steps']} times; {kept}"), highlight=False)
    console.print(
        escape(f"memory {said['memory_available'] / 1e9:.1f} of {said['memory_total'] / 1e9:.1f} GB available; {used}"),
        highlight=False,
    )
    console.print(escape(", ".join(f"{name} {version}" for name, version in said["versions"].items())), highlight=False)


def _seconds(value: float | None, end: str = "") -> str:
    return "none" if value is None else f"{value:.1f} s{end}"
