"""`ltm reprocess`: compute a site's fuel map again from archives of recordings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import print_table

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_ros.archive.engine import Engine
    from ltm_ros.archive.run import Plan, Summary


def reprocess(
    archives: Annotated[
        list[str],
        typer.Argument(help="Bags, .mcap files, folders with bags or photos and poses.csv, or s3://bucket/folder."),
    ],
    site: Annotated[Path, typer.Option("--site", help="Site file.")],
    out: Annotated[str, typer.Option("--out", "-o", help="Folder for results, or s3://bucket/folder.")],
    workers: Annotated[int, typer.Option(min=0, help="Worker processes on this machine; 0: work in this process.")] = 2,
    cluster: Annotated[str, typer.Option(help="Dask scheduler to use instead: tls://host:8786.")] = "",
    tls_ca: Annotated[Path | None, typer.Option(help="CA certificate of the cluster (PEM).")] = None,
    tls_cert: Annotated[Path | None, typer.Option(help="Own certificate (PEM).")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Key of the certificate (PEM).")] = None,
    cameras: Annotated[str, typer.Option(help="Only these cameras, separated by commas.")] = "",
    since: Annotated[str, typer.Option(help="First date or time, such as 2026-05-31, UTC.")] = "",
    until: Annotated[str, typer.Option(help="Last date (inclusive) or time, UTC.")] = "",
    sample: Annotated[str, typer.Option(help="Frames of each camera: all, or 4/day, 1/hour.")] = "all",
    shard: Annotated[str, typer.Option(help="i/n: process only the i-th of n parts, without a map.")] = "1/1",
    frames_per_task: Annotated[int, typer.Option(min=1, help="Maximum frames per camera and day.")] = 1500,
    max_failed: Annotated[str, typer.Option(help="Accepted share of lost frames.")] = "0.1%",
    burns: Annotated[Path | None, typer.Option(help="GeoJSON of burned areas, with `burned_at`.")] = None,
    terrain: Annotated[
        bool, typer.Option("--terrain", help="Also compute the site's terrain and use its changes.")
    ] = False,
    cache: Annotated[str, typer.Option(help="Folder for files of stores while they are read.")] = "",
    cache_gb: Annotated[float, typer.Option(min=0.001, help="Maximum size of these files per machine, in GB.")] = 20.0,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only count frames, find gaps and estimate the cost.")
    ] = False,
) -> None:
    """Reprocess all frames of ARCHIVES with SITE; write fuel map, layers and a record of the run to OUT.

    Run it again to resume. After a change, only affected results are recomputed.
    """
    from rich.console import Console

    from ltm_ros.archive.files import CacheConfig
    from ltm_ros.archive.run import ArchiveOptions, look_through, run
    from ltm_ros.archive.sampling import Sample
    from ltm_ros.cli.output import counting_bar
    from ltm_ros.fuel_map.layers import when

    console = Console()
    engine = _engine(workers, cluster, tls_ca, tls_cert, tls_key)
    options = ArchiveOptions(
        archives=tuple(archives),
        site=site,
        out=out,
        cameras=tuple(filter(None, cameras.split(","))),
        since_ns=when(since if "T" in since else f"{since}T00:00:00") if since else None,
        until_ns=when(until) if until else None,
        sample=Sample.parsed(sample),
        frames_per_task=frames_per_task,
        shard=_shard(shard),
        max_failed=_share(max_failed),
        burns=burns,
        terrain=terrain,
        cache=CacheConfig(cache or CacheConfig().folder, round(cache_gb * 1e9)),
    )
    with counting_bar(console, "scanning") as progress:
        planned = look_through(options, progress)
    if dry_run:
        _print_dry_run(console, planned)
        return
    with counting_bar(console, "working") as progress:
        summary = run(planned, engine, progress)
    _print(console, summary, out)


def _print_dry_run(console: Console, planned: Plan) -> None:
    from ltm_ros.archive.dry_run import COST_COLUMNS, cost_note, cost_rows, lost_rows

    title = f"{len(planned.frames)} frames in {len(planned.tasks)} tasks"
    print_table(console, title, COST_COLUMNS, cost_rows(planned))
    console.print(cost_note(planned), highlight=False)
    if lost := lost_rows(planned):
        print_table(console, "not used", ("camera", "cause", ">frames", "first reason"), lost)


def _engine(workers: int, cluster: str, ca: Path | None, certificate: Path | None, key: Path | None) -> Engine:
    from ltm_ros.archive.engine import Cluster, on_cluster, on_workers, serial

    if cluster:
        return on_cluster(Cluster(cluster, ca, certificate, key))
    return on_workers(workers) if workers else serial


def _print(console: Console, summary: Summary, out: str) -> None:
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


def _shard(text: str) -> tuple[int, int]:
    from ltm_core.base.errors import ArchiveError

    found = re.fullmatch(r"([0-9]+)/([0-9]+)", text)
    part, parts = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= part <= parts:
        raise ArchiveError(f"shard {text!r}: give i/n with i from 1 to n, such as 3/8")
    return part, parts


def _share(text: str) -> float:
    from ltm_core.base.errors import ArchiveError

    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(%?)", text)
    share = float(found[1]) / (100 if found[2] else 1) if found else -1.0
    if not 0 <= share <= 1:
        raise ArchiveError(f"share {text!r}: give a number such as 0.001, or 0.1%")
    return share
