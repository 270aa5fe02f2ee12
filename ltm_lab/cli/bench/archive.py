"""`ltm-lab bench archive`: how fast archives are reprocessed, and whether a month always gives the same map."""

from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.cli.bench.runs import print_conditions, print_table, write_json
from ltm_lab.options import JsonFile

_PACKAGES = ("numpy", "numba", "onnxruntime", "pyarrow")


def archive(
    bag: Annotated[Path | None, typer.Argument(help="Recording. Default: the demo's.")] = None,
    site: Annotated[Path | None, typer.Option("--site", help="Site file of the recording.")] = None,
    days: Annotated[int, typer.Option(help="Days on which the recording is repeated.", min=1)] = 60,
    month: Annotated[int, typer.Option(help="Reprocess a simulated month of this many days instead.", min=0)] = 0,
    seed: Annotated[int, typer.Option(help="Seed of the simulated month.", min=0)] = 5,
    keep: Annotated[Path | None, typer.Option(help="New folder that keeps the month and its maps.")] = None,
    json_path: JsonFile = None,
) -> None:
    """Reprocess a recording with one process and with two, and compare their speed.

    With --month, reprocess a simulated month of two towers in several ways and with four frames per day. The command
    then ends with status 1 if the maps differ, or the sample's in more than 0.1 % of the cells.
    """
    import tempfile

    from rich.console import Console

    from ltm_core.base.errors import ArchiveError
    from ltm_core.base.resources import project_path
    from ltm_lab.bench.archive import measure_speedup
    from ltm_lab.bench.measure import conditions

    if month:
        raise typer.Exit(0 if _month(month, seed, keep, json_path) else 1)
    if (bag is None) != (site is None):
        raise ArchiveError("the recording or its --site is missing; give both, or neither for the demo's")
    demo = project_path("bags/demo")
    console, state = Console(), conditions(_PACKAGES)
    print_conditions(console, state)
    with tempfile.TemporaryDirectory(prefix="ltm-bench-archive-") as folder, console.status("") as status:
        found = measure_speedup(
            bag or demo / "recording", site or demo / "site.yaml", Path(folder), days, status.update
        )
    print_table(
        console,
        f"{found.tasks} tasks of up to {found.frames} frames",
        ("", "frames per second"),
        [("one process", f"{found.alone_hz:.2f}"), ("two processes", f"{found.together_hz:.2f}")],
    )
    console.print(
        f"Two processes are {found.times:.2f} times as fast. A frame takes {found.alone_cpu_s:.3f} s of processor, "
        f"scheduler and client take {found.engine_share:.2%}."
    )
    write_json(json_path, state, times=found.times, **asdict(found))


def _month(days: int, seed: int, keep: Path | None, json_path: Path | None) -> bool:
    """Reprocess a simulated month and return whether all requirements hold."""
    import tempfile

    from rich.console import Console

    from ltm_lab.bench.archive_month import SAMPLE, measure_month
    from ltm_lab.bench.measure import conditions

    console, state = Console(), conditions(_PACKAGES)
    print_conditions(console, state)
    if keep is not None:
        keep.mkdir(parents=True)
    place = nullcontext(str(keep)) if keep is not None else tempfile.TemporaryDirectory(prefix="ltm-bench-month-")
    with place as folder, console.status("") as status:
        found = measure_month(Path(folder), days, status.update, seed)
    print_table(
        console,
        f"{found.frames} frames of {days} days",
        ("way", "frames worked", "wall s", "processor s", "digest"),
        [(one.name, one.worked, f"{one.wall_s:.1f}", f"{one.cpu_s:.1f}", one.digest[:12]) for one in found.runs],
        "processor: this process, without workers",
    )
    console.print(
        f"{SAMPLE}: {found.sample_frames} frames; {found.different} of {found.seen} seen cells have another code "
        f"({found.different / max(found.seen, 1):.3%}). Felled cells that have changed: {found.felled_changed:.0%} by "
        f"all frames, {found.sample_felled_changed:.0%} by the sample."
    )
    for reason, count in sorted(found.sample_rejected.items()):
        console.print(f"  {count} images rejected: {reason}")
    if keep is not None:
        console.print(f"Maps through time: {found.page}")
    write_json(json_path, state, holds=found.holds, **asdict(found))
    return found.holds
