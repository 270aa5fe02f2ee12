"""`ltm-lab bench terrain`: the cost of updating the surface map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def terrain(
    size: Annotated[int, typer.Option(help="Width of the square site in cells of 1 m.", min=500)] = 4000,
    repeats: Annotated[int, typer.Option(help="Frames that the least is taken of.", min=1)] = 5,
    views: Annotated[int, typer.Option(help="Directions that the tower looks into.", min=2)] = 12,
    json_path: JsonFile = None,
) -> None:
    """Processor time of the terrain's update a 1080p frame, and its memory."""
    import tempfile
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.terrain_map import measure_surface
    from ltm_lab.evaluation.figures_io import write_figures

    console = Console()
    state = conditions(("numpy", "numba", "opencv-python-headless"))
    load = " ".join(f"{v:.2f}" for v in state.load_average)
    console.print(f"{state.cpu}, {state.cores} cores, load average {load}, Python {state.python}")
    with console.status("measuring"), tempfile.TemporaryDirectory() as folder:
        cost = measure_surface(Path(folder), size, repeats, views)
    table = Table(title=f"terrain update, {cost.pixels[0]} x {cost.pixels[1]}, {cost.cells[0]} x {cost.cells[1]} cells")
    for name in ("", "processor ms", "wall ms"):
        table.add_column(name, justify="left" if not name else "right")
    for name, one in (
        ("a frame of a camera that stands still", cost.still),
        ("the same with a network's depth, over a wood, and labels", cost.told),
        ("a frame of one that has turned: registered, reference traced", cost.turned),
        ("deciding on change, for all frames since the last time", cost.decide),
    ):
        table.add_row(name, f"{one.cpu_ms:.0f}", f"{one.wall_ms:.0f}")
    console.print(table)
    console.print(
        f"memory of the map after {cost.views} views, with bare earth, surface and tracer, its store in a file: "
        f"{cost.memory_mb:.0f} MB ({cost.tiles} tiles of 64 x 64 cells in memory); "
        f"peak of the process {cost.peak_mb:.0f} MB"
    )
    if json_path is not None:
        write_figures(json_path, {"conditions": state.as_dict(), "cost": asdict(cost)})
