"""`ltm-lab bench trace`: time and memory of our tracer beside Embree, Mitsuba and the paper's march."""

from typing import Annotated

import typer

from ltm_lab.cli.bench.runs import numbers, print_conditions, print_table, write_json
from ltm_lab.options import JsonFile


def trace(
    sizes: Annotated[str, typer.Option(help="Widths of the square DEMs in cells of 1 m.")] = "2000,4000",
    scenes: Annotated[str, typer.Option(help="Scenes: parts of their names.")] = "1080p,VGA",
    tracers: Annotated[str, typer.Option(help="Tracers to run. Default: all.")] = "",
    repeats: Annotated[int, typer.Option(help="Frames per figure; the least counts.", min=1)] = 5,
    json_path: JsonFile = None,
) -> None:
    """Trace the same views with our tracer, Embree, Mitsuba and the paper's march.

    Separate several sizes, scenes or tracers with commas. Peers that are not installed are skipped.
    """
    from dataclasses import asdict

    from rich.console import Console

    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.tracing import SCENES, TRACERS, Skipped, TracerCost, frame_costs, run

    widths = [round(width) for width in numbers(sizes)]
    if min(widths) < 100:
        raise typer.BadParameter(f"{min(widths)} cells are too few; give at least 100", param_hint="--sizes")
    chosen = [scene for scene in SCENES if any(part in scene.name for part in scenes.split(","))]
    if not chosen:
        raise typer.BadParameter(f"no scene matches {scenes!r}; choose from {', '.join(s.name for s in SCENES)}")
    names = tuple(tracers.split(",")) if tracers else TRACERS
    if unknown := set(names) - set(TRACERS):
        raise typer.BadParameter(f"unknown tracer {', '.join(unknown)}; choose from {', '.join(TRACERS)}")
    console = Console()
    state = conditions(("numpy", "numba", "llvmlite", "embreex", "mitsuba", "drjit"))
    print_conditions(console, state)
    measured: list[TracerCost] = []
    skipped: list[Skipped] = []
    with console.status("measuring") as status:
        for result in run(widths, chosen, repeats, names):
            if isinstance(result, Skipped):
                skipped.append(result)
                console.print(f"{result.size}: {result.tracer} skipped: {result.reason}", markup=False)
            else:
                measured.append(result)
            status.update(f"measured {result.tracer} at {result.size}")
    frames = frame_costs(measured)
    print_table(
        console,
        "cost of a frame",
        ("tracer", "scene", "cells", "processor ms", "wall ms", "over warm", "over cold"),
        [
            (
                f"{one.tracer} {one.state}",
                one.scene,
                one.size,
                f"{one.cost.cpu_ms:,.1f}",
                f"{one.cost.wall_ms:,.1f}",
                *("" if ratio is None else f"{ratio:.1f}" for ratio in (one.over_warm, one.over_cold)),
            )
            for one in frames
        ],
        "march: every 8th pixel of every 8th row, scaled up; over warm, cold: processor time divided by ours",
    )
    print_table(
        console,
        "set-up, and peak memory beyond the DEM",
        ("tracer", "cells", "processor s", "memory MB"),
        [(one.tracer, one.size, f"{one.setup.cpu_ms / 1e3:,.2f}", f"{one.memory_mb:,.0f}") for one in measured],
    )
    write_json(
        json_path,
        state,
        frames=[asdict(one) for one in frames],
        setup=[{"size": m.size, "tracer": m.tracer, "memory_mb": m.memory_mb, **asdict(m.setup)} for m in measured],
        skipped=[asdict(one) for one in skipped],
    )
