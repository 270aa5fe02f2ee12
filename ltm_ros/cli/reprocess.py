"""`ltm reprocess`: compute a site's fuel map again from archives of recordings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.base.errors import ArchiveError
from ltm_ros.cli.output import print_table

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_ros.archive.run import Plan, Summary


def reprocess(
    archives: Annotated[list[Path], typer.Argument(help="Bags, .mcap files, and folders with bags.")],
    site: Annotated[Path, typer.Option("--site", help="Site file.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for results.")],
    workers: Annotated[int, typer.Option(min=0, help="Number of worker processes; 0: this one.")] = 2,
    cameras: Annotated[str, typer.Option(help="Only these cameras, separated by commas.")] = "",
    since: Annotated[str, typer.Option(help="First date or time, such as 2026-05-31, UTC.")] = "",
    until: Annotated[str, typer.Option(help="Last date (inclusive) or time, UTC.")] = "",
    sample: Annotated[str, typer.Option(help="Frames of each camera: all, or 4/day, 1/hour.")] = "all",
    max_failed: Annotated[str, typer.Option(help="Accepted share of lost frames.")] = "0.1%",
    burns: Annotated[Path | None, typer.Option(help="GeoJSON of burned areas, with `burned_at`.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only count frames and find gaps.")] = False,
) -> None:
    """Reprocess all frames of ARCHIVES with SITE; write fuel map, layers and a record of the run to OUT.

    Run it again to resume. After a change, only affected results are recomputed."""
    from rich.console import Console

    from ltm_ros.archive.run import ArchiveOptions, look_through, run
    from ltm_ros.archive.sampling import Sample
    from ltm_ros.archive.task import on_workers, serial
    from ltm_ros.cli.output import counting_bar
    from ltm_ros.fuel_map.layers import when

    console = Console()
    options = ArchiveOptions(
        archives=tuple(archives),
        site=site,
        out=out,
        cameras=tuple(filter(None, cameras.split(","))),
        since_ns=when(since if "T" in since else f"{since}T00:00:00") if since else None,
        until_ns=when(until) if until else None,
        sample=Sample.parsed(sample),
        max_failed=_share(max_failed),
        burns=burns,
    )
    with counting_bar(console, "scanning") as progress:
        planned = look_through(options, progress)
    if dry_run:
        _print_dry_run(console, planned)
        return
    with counting_bar(console, "working") as progress:
        summary = run(planned, on_workers(workers) if workers else serial, progress)
    _print(console, summary, out)


def _print_dry_run(console: Console, planned: Plan) -> None:
    from rich.markup import escape

    title = f"{len(planned.frames)} frames in {len(planned.tasks)} tasks"
    rows = []
    for camera in sorted({frame.camera for frame in planned.frames}):
        frames = [frame for frame in planned.frames if frame.camera == camera]
        days = {frame.day for frame in frames}
        without = max(days) - min(days) + 1 - len(days)
        size = sum(frame.size_bytes for frame in frames) / 1e9
        rows.append((camera, str(len(frames)), str(len(days)), str(without), f"{size:.3g}"))
    print_table(console, title, ("camera", ">frames", ">days", ">days without", ">GB in"), rows)
    manifest = planned.manifest
    console.print(f"{len(manifest.frames)} frames found; {manifest.repeated} duplicates ignored", highlight=False)
    failures = (*manifest.unread, *manifest.failures)
    lost = [(one.place, one.cause, str(one.count), escape(one.why)) for one in failures]
    told = "; ".join(one.why for one in failures)
    if lost := [*lost, *(("", "damage", "", escape(note)) for note in manifest.damage if note not in told)]:
        print_table(console, "not used", ("camera", "cause", ">frames", "first reason"), lost)


def _print(console: Console, summary: Summary, out: Path) -> None:
    console.print(
        f"{summary.worked} frames processed now, {summary.merged} in the map, {summary.failed} failed; "
        f"{summary.tasks} tasks"
    )
    for reason, count in sorted(summary.unused.items()):
        console.print(f"{count} not used: {reason}")
    for failure in summary.failures[:20]:
        console.print(f"{failure.place}: {failure.count} x {failure.cause}: {failure.why}")
    if summary.digest:
        console.print(f"fuel map: {out}/fuel_map.ltm, digest {summary.digest}")


def _share(text: str) -> float:
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(%?)", text)
    share = float(found[1]) / (100 if found[2] else 1) if found else -1.0
    if not 0 <= share <= 1:
        raise ArchiveError(f"share {text!r}: give a number such as 0.001, or 0.1%")
    return share
