"""A tower's state as tables in a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

STYLES = {"ok": "green", "troubled": "yellow", "silent": "bold red", "missing": "bold red"}


def print_status(said: Mapping[str, Any]) -> None:
    """`said`: as `TowerStatus.as_dict` has it."""
    console = Console()
    wrong = said["wrong"]
    console.print(
        f"[bold]{escape(said['site'])}[/]: {'all is well' if not wrong else f'{len(wrong)} things are wrong'}"
    )
    for line in wrong:
        console.print(f"  - {escape(line)}", style="yellow", highlight=False)
    cameras = Table("camera", "newest frame", "frames", "finished", "given up", "latency", "pose")
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
        cameras.add_row(*map(escape, cells))
    nodes = Table("node", "state", "in", "out", "given up", "work p95", "says")
    for one in said["nodes"]:
        values = one["values"]
        work = values.get("work_p95_ms")
        nodes.add_row(
            escape(one["name"]),
            f"[{STYLES[one['state']]}]{one['state']}[/]",
            escape(values.get("frames_in", "")),
            escape(values.get("frames_out", "")),
            escape(values.get("dropped", "")),
            escape(f"{work} ms" if work else ""),
            escape(one["said"][:80]),
        )
    console.print(cameras)
    console.print(nodes)
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
