"""`ltm-lab bench archive`: one map whatever works a recording again, and what a frame costs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def archive(
    bag: Annotated[Path | None, typer.Argument(help="Bag; default: the demo's.")] = None,
    site: Annotated[Path | None, typer.Option("--site", help="Its site file.")] = None,
    kills: Annotated[int, typer.Option(help="Runs in which a worker is killed at a random moment.", min=0)] = 3,
    kill_all: Annotated[
        int, typer.Option("--kill-all", help="Kills of workers and of whole commands on one more way.", min=0)
    ] = 0,
    seed: Annotated[int, typer.Option(help="Of these moments.")] = 1,
    empty: Annotated[int, typer.Option(help="Tasks that do nothing, for the engine's own cost.", min=0)] = 0,
    month: Annotated[
        int, typer.Option("--month", min=0, help="Days of a simulated month in its place, such as 30.")
    ] = 0,
    draw: Annotated[int, typer.Option(help="Which month is drawn; another number, another month.", min=0)] = 5,
    looks: Annotated[
        str, typer.Option("--looks", help="Months by their numbers, such as 7,8: only what four looks a day cost each.")
    ] = "",
    speedup: Annotated[
        int, typer.Option("--speedup", min=0, help="Days of the recording, by one process and by two, in its place.")
    ] = 0,
    keep: Annotated[Path | None, typer.Option(help="New folder in which the month and its maps stay.")] = None,
    json_path: JsonFile = None,
) -> None:
    """Work a recording again in several ways, and replay it: the digests of their maps, and the time they took.

    With --month, that of a drawn month of two towers, and how far the map of four looks a day is from it; with --looks,
    the latter of several months, and nothing else. Ends with status 1 where the digests differ, or more than a
    thousandth of the codes.
    """
    import tempfile
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from ltm_core.base.errors import ArchiveError
    from ltm_core.base.resources import project_path
    from ltm_lab.bench.archive import measure
    from ltm_lab.bench.measure import conditions
    from ltm_lab.cli.bench.runs import print_conditions
    from ltm_lab.evaluation.figures_io import write_figures

    if looks:
        raise typer.Exit(0 if _looks(_numbers(looks), month or 30, json_path) else 1)
    if month:
        raise typer.Exit(0 if _month(month, draw, keep, json_path) else 1)
    if (bag is None) != (site is None):
        raise ArchiveError("give both the bag and its --site, or neither for the demo's")
    console = Console()
    state = conditions(("numpy", "numba", "onnxruntime", "dask", "pyarrow"))
    demo = project_path("bags/demo")
    if speedup:
        _speedup(bag or demo / "recording", site or demo / "site.yaml", speedup, json_path)
        return
    with tempfile.TemporaryDirectory(prefix="ltm-bench-archive-") as folder, console.status("") as status:
        found = measure(
            bag or demo / "recording",
            site or demo / "site.yaml",
            Path(folder),
            kills,
            empty,
            seed,
            status.update,
            kill_all,
        )
    table = Table(title=f"{found.frames} frames", caption="processor: of this process alone, not of workers")
    for column in ("way", "worked", "killed", "wall s", "processor s", "a frame", "digest"):
        table.add_column(column, justify="left" if column in ("way", "digest") else "right")
    for way in found.ways:
        each = f"{way.cpu_s / way.worked:.3f}" if way.worked and "worker" not in way.name else ""
        spent = f"{way.wall_s:.2f}", f"{way.cpu_s:.2f}"
        table.add_row(way.name, str(way.worked), str(way.kills), *spent, each, way.digest[:12])
    console.print(table)
    console.print(
        f"{len(found.digests)} digest{'s' * (len(found.digests) > 1)} of {len(found.ways)} maps; votes "
        f"{found.votes_bytes / 1e3:.1f} kB a frame in files of a camera's day; {found.peak_mb:.0f} MB at most serially"
    )
    console.print(
        f"a worker alone: {found.worker.to_votes_s:.3f} s of processor a frame to votes, {found.worker.tasks_s:.3f} s "
        f"with evidence and files, {found.worker.peak_mb:.0f} MB at most"
    )
    if found.worker.to_measured_s is not None:
        console.print(
            f"the same with fusion: {found.worker.to_measured_s:.3f} s a frame to votes and measured depth, "
            f"{found.worker.fusing_peak_mb:.0f} MB at most; measured {(found.worker.measured_bytes or 0) / 1e3:.0f} kB "
            "a frame"
        )
    for share in found.shares:
        console.print(share.said)
    if found.engine is not None:
        idle = found.engine
        console.print(
            f"{idle.tasks} empty tasks: {idle.each_ms:.2f} ms each for scheduler and client, whose process held "
            f"{idle.early_mb:.0f} MB after a tenth of them and {idle.late_mb:.0f} MB after all"
        )
    print_conditions(console, state)
    if json_path is not None:
        write_figures(json_path, {"conditions": state.as_dict(), **asdict(found)})
    raise typer.Exit(0 if len(found.digests) == 1 else 1)


def _speedup(bag: Path, site: Path, days: int, json_path: Path | None) -> None:
    import tempfile
    from dataclasses import asdict

    from rich.console import Console

    from ltm_lab.bench.archive_speedup import measure_speedup
    from ltm_lab.bench.measure import conditions
    from ltm_lab.cli.bench.runs import print_conditions
    from ltm_lab.evaluation.figures_io import write_figures

    console, state = Console(), conditions(("numpy", "numba", "onnxruntime", "dask", "pyarrow"))
    with tempfile.TemporaryDirectory(prefix="ltm-bench-speedup-") as folder, console.status("") as status:
        found = measure_speedup(bag, site, Path(folder), days, status.update)
    console.print(
        f"{found.tasks} tasks of up to {found.frames} frames: {found.alone:.2f} frames a second by one process, "
        f"{found.together:.2f} by two: {found.times:.2f} times"
    )
    console.print(found.share.said)
    print_conditions(console, state)
    if json_path is not None:
        write_figures(json_path, {"conditions": state.as_dict(), "times": found.times, **asdict(found)})


def _month(days: int, draw: int, keep: Path | None, json_path: Path | None) -> bool:
    """Whether all holds."""
    import tempfile
    from contextlib import nullcontext
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from ltm_lab.bench.archive_month import measure_month
    from ltm_lab.bench.measure import conditions
    from ltm_lab.cli.bench.runs import print_conditions
    from ltm_lab.evaluation.figures_io import write_figures

    console, state = Console(), conditions(("numpy", "numba", "onnxruntime", "dask", "pyarrow"))
    if keep is not None:
        keep.mkdir(parents=True)
    place = nullcontext(str(keep)) if keep is not None else tempfile.TemporaryDirectory(prefix="ltm-bench-month-")
    with place as folder, console.status("") as status:
        found = measure_month(Path(folder), days, status.update, draw)
    table = Table(title=f"{found.frames} frames of {days} days", caption="processor: of this process, not of workers")
    for column in ("way", "worked", "wall s", "processor s", "digest"):
        table.add_column(column, justify="left" if column in ("way", "digest") else "right")
    for way in (*found.ways, *found.burned_ways):
        table.add_row(way.name, str(way.worked), f"{way.wall_s:.1f}", f"{way.cpu_s:.1f}", way.digest[:12])
    console.print(table)
    if (again := found.resumed) is not None:
        console.print(
            f"{again.tasks} done tasks again: {again.whole_s:.1f} s ({again.whole_cpu_s:.1f} s of processor) where all "
            f"is there, {again.remade_s:.1f} s ({again.remade_cpu_s:.1f} s) where the map and its layers are made again"
        )
    if found.share is not None:
        console.print(found.share.said)
    console.print(f"of the felled cells {found.felled_found:.0%} have changed by all frames")
    for one in found.samples:
        console.print(one.said(found.seen))
        for reason, count in sorted(one.passed_over.items()):
            console.print(f"  {count} passed over: {reason}")
    if keep is not None:
        console.print(f"maps through time: {found.page}")
    print_conditions(console, state)
    if json_path is not None:
        write_figures(json_path, {"conditions": state.as_dict(), "holds": found.holds, **asdict(found)})
    return found.holds


def _looks(draws: list[int], days: int, json_path: Path | None) -> bool:
    """Whether no more codes than wanted are others, of all months together."""
    import tempfile
    from dataclasses import asdict

    from rich.console import Console

    from ltm_lab.bench.archive_month import WANTED, measure_looks
    from ltm_lab.bench.measure import conditions
    from ltm_lab.cli.bench.runs import print_conditions
    from ltm_lab.evaluation.figures_io import write_figures

    console, state = Console(), conditions(("numpy", "numba", "onnxruntime", "pyarrow"))
    found = []
    for draw in draws:
        with tempfile.TemporaryDirectory(prefix="ltm-bench-looks-") as folder, console.status("") as status:
            one = measure_looks(Path(folder), days, draw, status.update)
        found.append(one)
        felled = f"by all frames {one.felled_found:.0%} of the felled cells"
        console.print(f"month {draw}: {one.samples[0].said(one.seen)}, {felled}")
    different, seen = sum(one.samples[0].different for one in found), sum(one.seen for one in found)
    console.print(f"together: {different} of {seen} ({different / max(seen, 1):.3%}; {WANTED:.1%} wanted)")
    print_conditions(console, state)
    if json_path is not None:
        write_figures(json_path, {"conditions": state.as_dict(), "months": [asdict(one) for one in found]})
    return different <= WANTED * seen


def _numbers(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError as error:
        raise typer.BadParameter(f"months are whole numbers with commas, such as 7,8; got {text!r}") from error
