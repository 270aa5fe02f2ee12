"""`ltm-lab bench`: measures the cost of each part; `ltm-lab bench trace` compares the tracer with other ray tracers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ltm_lab.cli.bench.archive import archive
from ltm_lab.cli.bench.bounds import bounds
from ltm_lab.cli.bench.fusion import fusion
from ltm_lab.cli.bench.graph import graph
from ltm_lab.cli.bench.kills import kills
from ltm_lab.cli.bench.memory import memory
from ltm_lab.cli.bench.network import network
from ltm_lab.cli.bench.region import region
from ltm_lab.cli.bench.render import render
from ltm_lab.cli.bench.runs import print_conditions
from ltm_lab.cli.bench.segmentation import segmentation
from ltm_lab.cli.bench.sources import sources
from ltm_lab.cli.bench.terrain import terrain
from ltm_lab.cli.bench.votes import votes
from ltm_ros.cli.output import JsonFile

bench = typer.Typer(
    help="How fast, in how much memory: tracing, beside other tracers; the graph; a fuel map under many towers.",
    no_args_is_help=True,
)
bench.command()(graph)
bench.command()(archive)
bench.command()(bounds)
bench.command()(kills)
bench.command()(memory)
bench.command()(network)
bench.command()(fusion)
bench.command()(region)
bench.command()(render)
bench.command()(segmentation)
bench.command()(sources)
bench.command()(terrain)
bench.command()(votes)


@bench.command()
def trace(
    sizes: Annotated[str, typer.Option(help="Widths of the square DEMs in cells of 1 m, with commas.")] = "2000,4000",
    scenes: Annotated[str, typer.Option(help="Only scenes whose name holds one of these, with commas.")] = "1080p,VGA",
    tracers: Annotated[str, typer.Option(help="Only these tracers, with commas; all where empty.")] = "",
    repeats: Annotated[int, typer.Option(help="Frames that each figure is the least of.", min=1)] = 5,
    json_path: JsonFile = None,
    peers: Annotated[
        Path | None,
        typer.Option(help="Folder with packages for peers only (pip install --target), looked at after our own."),
    ] = None,
) -> None:
    """Trace the same views with ours and with embreex, Open3D, Mitsuba and the paper's march."""
    import json
    import sys

    from rich.console import Console

    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.summary import growth, rows
    from ltm_lab.bench.tracing import SCENES, Measured, Skipped, run

    if peers is not None:
        if not peers.is_dir():
            raise typer.BadParameter(f"no such folder: {peers}", param_hint="--peers")
        sys.path.append(str(peers))  # the measuring processes get this path too
    console = Console()
    widths = _widths(sizes)
    chosen = [s for s in SCENES if any(part in s.name for part in scenes.split(","))]
    if not chosen:
        raise typer.BadParameter(f"no scene is called {scenes!r}; there are {', '.join(s.name for s in SCENES)}")
    state = conditions(("numpy", "numba", "llvmlite", "embreex", "open3d", "mitsuba", "drjit"))
    print_conditions(console, state)
    measured: list[Measured] = []
    skipped: list[Skipped] = []
    try:
        with console.status("measuring") as status:
            only = set(tracers.split(",")) if tracers else None
            for result in run(widths, chosen, repeats, only):
                if isinstance(result, Skipped):
                    skipped.append(result)
                    console.print(f"{result.size}: {result.tracer} skipped: {result.reason}", markup=False)
                else:
                    measured.append(result)
                status.update(f"measured {result.tracer} at {result.size}")
    except KeyboardInterrupt:
        console.print("interrupted; what was measured until then:")
    table = rows(measured, chosen)
    slopes = growth(table)
    for scene in chosen:
        console.print(_scene_table(scene.name, [r for r in table if r["scene"] == scene.name]))
    console.print(_setup_table(table))
    if slopes:
        console.print(_growth_table(slopes))
    if json_path is not None:
        report = {
            "conditions": state.as_dict(),
            "rows": table,
            "growth": slopes,
            "skipped": [vars(s) for s in skipped],
        }
        json_path.parent.mkdir(parents=True, exist_ok=True)
        json_path.write_text(json.dumps(report, indent=2))


def _widths(text: str) -> list[int]:
    try:
        widths = [int(part) for part in text.split(",")]
    except ValueError as error:
        raise typer.BadParameter(f"sizes must be whole numbers with commas, got {text!r}") from error
    if min(widths) < 100:
        raise typer.BadParameter(f"a DEM here is at least 100 cells wide, got {min(widths)}")
    return widths


_NAMES = ("embreex", "open3d", "mitsuba", "march", "march_numpy")


def _number(value: float | None, form: str = ",.1f") -> str:
    return "" if value is None else f"{value:{form}}"


def _scene_table(scene: str, table: list[dict[str, Any]]) -> Any:
    from rich.table import Table

    shown = Table(
        title=f"{scene}, a frame",
        caption="marches: every 8th (NumPy: 48th) pixel both ways, scaled up; ratios: processor time over ours",
    )
    for name in ("cells", "tracer", "processor ms", "wall ms", "over warm", "over cold"):
        shown.add_column(name, justify="left" if name == "tracer" else "right")
    for row in table:
        for state in ("warm", "cold", "still"):
            costs = (_number(row[f"ours_{state}_{clock}_ms"]) for clock in ("cpu", "wall"))
            shown.add_row(f"{row['size']}²", f"ours, {state}", *costs, "", "")
        for name in _NAMES:
            if row[f"{name}_cpu_ms"] is not None:
                costs = (_number(row[f"{name}_{clock}_ms"]) for clock in ("cpu", "wall"))
                ratios = (_number(row[f"ratio_{name}_{state}"]) for state in ("warm", "cold"))
                shown.add_row(f"{row['size']}²", name, *costs, *ratios)
        shown.add_section()
    return shown


def _setup_table(table: list[dict[str, Any]]) -> Any:
    from rich.table import Table

    shown = Table(title="set-up, and peak memory beyond the DEM with frames")
    for name in ("cells", "tracer", "processor s", "memory MB"):
        shown.add_column(name, justify="left" if name == "tracer" else "right")
    for row in {r["size"]: r for r in table}.values():
        for name in ("ours", *_NAMES):
            cost = row[f"{name}_setup_cpu_ms"]
            if cost is not None:
                shown.add_row(
                    f"{row['size']}²", name, _number(cost / 1e3, ",.2f"), _number(row[f"{name}_memory_mb"], ",.0f")
                )
        shown.add_section()
    return shown


def _growth_table(slopes: dict[str, dict[str, float]]) -> Any:
    from rich.table import Table

    shown = Table(title="growth, log-log slopes: with the DEM's area, and with pixels (1: in proportion)")
    kinds = ("frame", "setup", "memory", "pixels")
    for name in ("", *kinds):
        shown.add_column(name, justify="right")
    for name, by_kind in slopes.items():
        shown.add_row(name, *(_number(by_kind.get(kind), ".2f") for kind in kinds))
    return shown
