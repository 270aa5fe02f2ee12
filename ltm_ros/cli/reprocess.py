"""`ltm reprocess`: compute a site's fuel map again from archives of recordings."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import mean, stdev
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import print_table

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_ros.archive.manifest import ArchiveFrame
    from ltm_ros.archive.run import Plan, Summary


def reprocess(
    archives: Annotated[
        list[Path],
        typer.Argument(help="Bags, .mcap files, folders with bags or photos and poses.csv."),
    ],
    site: Annotated[Path, typer.Option("--site", help="Site file.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for results.")],
    workers: Annotated[int, typer.Option(min=0, help="Number of worker processes; 0: this one.")] = 2,
    cameras: Annotated[str, typer.Option(help="Only these cameras, separated by commas.")] = "",
    since: Annotated[str, typer.Option(help="First date or time, such as 2026-05-31, UTC.")] = "",
    until: Annotated[str, typer.Option(help="Last date (inclusive) or time, UTC.")] = "",
    sample: Annotated[str, typer.Option(help="Frames of each camera: all, or 4/day, 1/hour.")] = "all",
    max_failed: Annotated[str, typer.Option(help="Accepted share of lost frames.")] = "0.1%",
    burns: Annotated[Path | None, typer.Option(help="GeoJSON of burned areas, with `burned_at`.")] = None,
    terrain: Annotated[
        bool, typer.Option("--terrain", help="Also compute the site's terrain and use its changes.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only count frames, find gaps and estimate the cost.")
    ] = False,
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
        terrain=terrain,
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
    columns = ("camera", ">frames", ">days", ">days without", ">GB in", ">core-hours", ">made, MB")
    print_table(console, title, columns, _cost_rows(planned))
    to = "votes and measured depth, without the terrain's map" if planned.options.terrain else "votes"
    console.print(
        f"{len(planned.manifest.frames)} frames found, {planned.manifest.repeated} of them duplicates; core-hours "
        f"to {to}, from {_TRIED} frames of each camera, with the standard error; bytes of {to.partition(',')[0]} "
        "as of single frames",
        highlight=False,
    )
    failures = (*planned.manifest.unread, *planned.manifest.failures)
    lost = [(one.place, one.cause, str(one.count), escape(one.why)) for one in failures]
    told = "; ".join(one.why for one in failures)
    if lost := [*lost, *(("", "damage", "", escape(note)) for note in planned.manifest.damage if note not in told)]:
        print_table(console, "not used", ("camera", "cause", ">frames", "first reason"), lost)


_TRIED = 3
"""Number of frames per camera for the estimate, after one that loads kernels and network."""


def _cost_rows(planned: Plan) -> list[tuple[str, ...]]:
    """Return frames, gaps and costs of each camera."""
    from ltm_ros.archive.manifest import days_of

    rows: list[tuple[str, ...]] = []
    days = days_of(planned.frames)
    for camera in sorted({frame.camera for frame in planned.frames}):
        frames = [frame for frame in planned.frames if frame.camera == camera]
        its = sorted(day for name, day in days if name == camera)
        cpu_s, error_s, made = _cost_of(frames, planned)
        hours, error = (seconds * len(frames) / 3600 for seconds in (cpu_s, error_s))
        rows.append(
            (
                *(camera, str(len(frames)), str(len(its)), str(its[-1] - its[0] + 1 - len(its))),
                f"{sum(frame.size_bytes for frame in frames) / 1e9:.3g}",
                f"{hours:.3g} ± {error:.1g}",
                f"{made * len(frames) / 1e6:.3g}",
            )
        )
    return rows


def _cost_of(frames: Sequence[ArchiveFrame], planned: Plan) -> tuple[float, float, float]:
    """Return the CPU seconds of a camera's frame from image to results, the standard error of their mean, and the bytes
    of the results, estimated from a few frames, spread over all; nothing is kept."""
    from ltm_ros.archive.frame_files import frame_files
    from ltm_ros.archive.plan import MEASURED, VOTES

    steps = {task.frames[0].camera: task for task in planned.tasks}
    wanted = [VOTES, MEASURED] if planned.options.terrain else [VOTES]
    chosen = [frames[round(k * (len(frames) - 1) / (_TRIED - 1))] for k in range(_TRIED)]
    seconds, sizes = [], []
    for frame in [chosen[0], *chosen]:
        begin = time.process_time()
        made = frame_files(replace(steps[frame.camera], frames=(frame,)), planned.settings, wanted)
        seconds.append(time.process_time() - begin)
        sizes.append(sum(map(len, made.values())))
    return mean(seconds[1:]), stdev(seconds[1:]) / math.sqrt(_TRIED), mean(sizes[1:])


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
    if summary.terrain_digest:
        console.print(
            f"terrain: {out}/terrain.sqlite, {summary.terrain_frames} frames, digest {summary.terrain_digest}"
        )


def _share(text: str) -> float:
    from ltm_core.base.errors import ArchiveError

    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(%?)", text)
    share = float(found[1]) / (100 if found[2] else 1) if found else -1.0
    if not 0 <= share <= 1:
        raise ArchiveError(f"share {text!r}: give a number such as 0.001, or 0.1%")
    return share
