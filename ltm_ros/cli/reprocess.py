"""`ltm reprocess`: compute a site's fuel map again from archives of recordings."""

import re
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ltm_core.base.errors import ArchiveError
from ltm_ros.archive.run import ArchiveOptions, Plan, look_through, run
from ltm_ros.archive.sampling import Sample
from ltm_ros.archive.task import on_workers, serial
from ltm_ros.cli.output import print_table, progress_bar, say
from ltm_ros.fuel_map.layers import when


def reprocess(
    archives: Annotated[list[Path], Argument(help="Bags, .mcap files, and folders with bags.")],
    site: Annotated[Path, Option(help="Site file.")],
    out: Annotated[Path, Option("--out", "-o", help="Folder for results.")],
    workers: Annotated[int, Option(min=0, help="Number of worker processes; 0: this one.")] = 2,
    cameras: Annotated[str, Option(help="Only these cameras, separated by commas.")] = "",
    since: Annotated[str, Option(help="First date or time, such as 2026-05-31, UTC.")] = "",
    until: Annotated[str, Option(help="Last date (inclusive) or time, UTC.")] = "",
    sample: Annotated[str, Option(help="Frames of each camera: all, or 4/day, 1/hour.")] = "all",
    max_failed: Annotated[str, Option(help="Accepted share of lost frames.")] = "0.1%",
    burns: Annotated[Path | None, Option(help="GeoJSON of burned areas, with `burned_at`.")] = None,
    dry_run: Annotated[bool, Option("--dry-run", help="Only count frames and find gaps.")] = False,
) -> None:
    """Reprocess all frames of ARCHIVES with SITE; write fuel map, layers and a record of the run to OUT.

    Run it again to resume. After a change, only affected results are recomputed."""
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
    with progress_bar("scanning") as progress:
        planned = look_through(options, progress)
    if dry_run:
        _print_dry_run(planned)
        return
    with progress_bar("working") as progress:
        summary = run(planned, on_workers(workers) if workers else serial, progress)
    merged = f"{summary.worked} frames processed now, {summary.merged} in the map, {summary.failed} failed"
    say(f"{merged}; {summary.tasks} tasks")
    for reason, count in sorted(summary.unused.items()):
        say(f"{count} not used: {reason}")
    for failure in summary.failures[:20]:
        say(f"{failure.place}: {failure.count} x {failure.cause}: {failure.why}")
    if summary.digest:
        say(f"fuel map: {out}/fuel_map.ltm, digest {summary.digest}")


def _print_dry_run(planned: Plan) -> None:
    title = f"{len(planned.frames)} frames in {len(planned.tasks)} tasks"
    rows = []
    for camera in sorted({frame.camera for frame in planned.frames}):
        frames = [frame for frame in planned.frames if frame.camera == camera]
        days = {frame.day for frame in frames}
        without = max(days) - min(days) + 1 - len(days)
        size = sum(frame.size_bytes for frame in frames) / 1e9
        rows.append((camera, str(len(frames)), str(len(days)), str(without), f"{size:.3g}"))
    print_table(title, ("camera", ">frames", ">days", ">days without", ">GB in"), rows)
    manifest = planned.manifest
    say(f"{len(manifest.frames)} frames found; {manifest.repeated} duplicates ignored")
    failures = (*manifest.unread, *manifest.failures)
    lost = [(one.place, one.cause, str(one.count), one.why) for one in failures]
    told = "; ".join(one.why for one in failures)
    if lost := [*lost, *(("", "damage", "", note) for note in manifest.damage if note not in told)]:
        print_table("not used", ("camera", "cause", ">frames", "first reason"), lost)


def _share(text: str) -> float:
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(%?)", text)
    share = float(found[1]) / (100 if found[2] else 1) if found else -1.0
    if not 0 <= share <= 1:
        raise ArchiveError(f"share {text!r}: give a number such as 0.001, or 0.1%")
    return share
