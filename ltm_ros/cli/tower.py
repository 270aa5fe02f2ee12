"""`ltm status`, `doctor`, `upgrade` and `rollback`: commands for an installed tower."""

import json
import os
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ltm_core.base.errors import ConfigError
from ltm_core.base.number_text import counted
from ltm_ros.cli.output import print_findings, print_table, say, warn

if TYPE_CHECKING:
    from ltm_ros.tower.upgrade import Upgrade


INSTALLED_SITE = Path("/etc/ltm/site.yaml")
STYLES = {"ok": "green", "optional": "dim", "warning": "yellow", "silent": "bold red", "missing": "bold red"}


def status(
    site: Annotated[Path, Argument(help="Site file (YAML), with the section `health`.")] = INSTALLED_SITE,
    json_: Annotated[bool, Option("--json", help="Print the status as JSON.")] = False,
) -> None:
    """Print the state of a running tower. Exit code 0 if all nodes are healthy and all cameras send, else 1."""
    from ltm_core.site.site_io import load_site
    from ltm_ros.tower.health_client import ask

    config = load_site(site).health
    if config is None:
        raise ConfigError(f"{site}: has no section `health`; add `health: {{}}` and restart the tower")
    said: dict[str, Any] = ask(config, "/status.json")
    if json_:
        typer.echo(json.dumps(said, indent=2))
    else:
        _print_status(said)
    raise typer.Exit(0 if said["ready"] else 1)


def _print_status(said: Mapping[str, Any]) -> None:
    """Print what `TowerStatus.as_dict` returns."""
    from datetime import UTC, datetime

    wrong = said["wrong"]
    say(f"{said['site']}: {counted(len(wrong), 'problem') if wrong else 'no problems'}", "bold")
    for line in wrong:
        warn(f"  - {line}")
    cameras = []
    for one in said["cameras"]:
        dropped = ", ".join(f"{cause} {count}" for cause, count in sorted(one["dropped"].items()))
        since = f"{datetime.fromtimestamp(one['since_s'], UTC):%m-%d %H:%M:%S}"
        newest, latency = _seconds(one["frame_age_s"], " ago"), _seconds(one["latency_s"])
        frames = str(one["frames_in"]), str(one["finished"])
        cameras.append((one["name"], one["state"], since, newest, *frames, dropped, latency, one["pose"], one["why"]))
    nodes = []
    for one in said["nodes"]:
        work = one["values"].get("work_p95_ms")
        counts = (one["values"].get(key, "") for key in ("frames_in", "frames_out", "dropped"))
        cells = (*counts, f"{work} ms" if work else "", one["said"][:80])
        nodes.append((one["name"], (STYLES[one["state"]], one["state"]), *cells))
    columns = (
        "camera", "state", "since (UTC)", ">newest", ">frames", ">finished", "dropped", ">latency", "pose", "reason"
    )  # fmt: skip
    print_table("", columns, cameras)
    print_table("", ("node", "state", ">in", ">out", ">dropped", ">work p95", "message"), nodes)
    if (outbox := said["outbox"]) is not None:
        link = "connected to the region's map" if outbox["link_up"] else "no connection to the region's map"
        waiting = f"{outbox['frames']} frames, {outbox['bytes'] / 1e6:.1f} MB, oldest {outbox['age_s']:.0f} s"
        say(f"outbox: {waiting}; {link}")
    kept = "; ".join(f"{d['folder']} {d['free'] / 1e9:.1f} of {d['total'] / 1e9:.0f} GB free" for d in said["disks"])
    clock = {True: "synchronised", False: "not synchronised (no NTP)", None: "synchronisation unknown"}
    say(f"clock {clock[said['clock']['synchronised']]}; {kept}")
    say(f"memory {said['memory_available'] / 1e9:.1f} of {said['memory_total'] / 1e9:.1f} GB available")
    say(", ".join(f"{name} {version}" for name, version in said["versions"].items()))


def _seconds(value: float | None, end: str = "") -> str:
    return "none" if value is None else f"{value:.1f} s{end}"


def doctor(
    json: Annotated[bool, Option("--json", help="Print the findings as JSON.")] = False,
    site: Annotated[Path | None, Option(help="Site file, to check its port. Default: /etc/ltm/site.yaml.")] = None,
) -> None:
    """Check the installation. Exit code 1 if something required is missing, or the site file is invalid."""
    from ltm_ros.tower.doctor import DoctorState, as_json, examine

    findings = examine(site)
    missing = [finding.name for finding in findings if finding.state is DoctorState.MISSING]
    if json:
        typer.echo(as_json(findings))
        raise typer.Exit(1 if missing else 0)
    print_findings((one.area, one.state, STYLES[one.state], one.name, one.detail) for one in findings)
    # Printed below the table without line breaks, so that they can be copied.
    for finding in findings:
        if finding.remedy:
            typer.echo(f"{finding.state} {finding.name}: {finding.remedy}")
    typer.echo(f"missing: {', '.join(missing)}" if missing else "nothing required is missing")
    raise typer.Exit(1 if missing else 0)


READY_MINUTES = 2.0
"""Time in minutes in which a release must be ready. Kernels are compiled before, so a good release starts in seconds;
the tower should be down for three minutes at most, and going back to the previous release takes part of them."""


def upgrade(
    package: Annotated[Path, Argument(help="Debian package of a release (`make deb`).")],
    ready_minutes: Annotated[float, Option(min=0.1, help="Minutes in which it must be ready.")] = READY_MINUTES,
) -> None:
    """Install another release of LTM; if it does not start, the previous one returns. Needs root.

    The new release is checked first (`ltm doctor`, `ltm check`, its kernels) while the current one runs. The stores are
    copied before it is started."""
    import subprocess  # nosec B404 # argument lists, no shell

    from ltm_ros.tower.releases import PackageFile

    change = _upgrade(ready_minutes)
    opened = PackageFile.open(package)
    change.install(opened)
    # dpkg takes over the files now; the service already runs them.
    ran = subprocess.run(  # nosec B603 B607 # no shell; root's own PATH
        ["dpkg", "--install", str(opened.path)], env=os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    )
    if ran.returncode:
        typer.echo("-- dpkg failed: `dpkg --configure ltm` prints the reason; the release runs all the same", err=True)
        raise typer.Exit(1)


def rollback(
    to: Annotated[str, Option(help="Version to return to. Default: the previous one.")] = "",
    unconfirmed: Annotated[bool, Option("--unconfirmed", help="Only after an interrupted upgrade.")] = False,
    ready_minutes: Annotated[float, Option(min=0.1, help="Minutes in which it must be ready.")] = READY_MINUTES,
) -> None:
    """Return to the previous release of LTM. Needs root."""
    change = _upgrade(ready_minutes)
    if unconfirmed:
        returned = change.return_unconfirmed()
        typer.echo(f"-- back on {returned}: the release on trial did not start" if returned else "-- nothing to do")
        return
    change.go_back(to)


def _upgrade(ready_minutes: float) -> "Upgrade":
    from ltm_ros.launching.runner import print_line  # a radio link may have dropped: its errors do not end the upgrade
    from ltm_ros.tower.releases import ROOT, Releases
    from ltm_ros.tower.store_copy import SystemdService
    from ltm_ros.tower.upgrade import Places, Upgrade

    releases = Releases()
    _ = releases.current  # first check that this is an installed tower
    if os.geteuid() != 0 or not os.access(ROOT, os.W_OK):
        raise ConfigError("upgrade and rollback need root: sudo ltm upgrade ...")
    # If a radio link drops, the shell and its terminal end. The upgrade still runs to its end, or back.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    return Upgrade(releases, SystemdService(), Places(), lambda line: print_line(f"-- {line}"), ready_minutes * 60.0)
