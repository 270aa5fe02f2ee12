"""`ltm-lab bench fusion`: processor time of fusing one frame's traced and network depth."""

from __future__ import annotations

from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def fusion(
    width: Annotated[int, typer.Option(help="Of the photo, pixels.", min=64)] = 1920,
    height: Annotated[int, typer.Option(help="Of the photo, pixels.", min=64)] = 1080,
    repeats: Annotated[int, typer.Option(help="Calls that each figure is the least of.", min=1)] = 7,
    json_path: JsonFile = None,
) -> None:
    """Fuse one frame's depths: processor time by part, the network's own time aside."""
    from rich.console import Console
    from rich.table import Table

    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.topodepth import NETWORK_SIZE, run
    from ltm_lab.evaluation.figures_io import write_figures

    console = Console()
    state = conditions(("numpy", "numba", "opencv-python-headless"))
    with console.status("measuring"):
        costs = run(width, height, repeats)
    table = Table(title=f"fusion of a {width} x {height} frame, network of {NETWORK_SIZE[1]} x {NETWORK_SIZE[0]}")
    for column in ("part", "processor ms", "wall ms"):
        table.add_column(column, justify="left" if column == "part" else "right")
    for row in costs:
        if row is costs[-1]:
            table.add_section()
        table.add_row(row.part, f"{row.cost.cpu_ms:.1f}", f"{row.cost.wall_ms:.1f}")
    console.print(table)
    load = " ".join(f"{value:.2f}" for value in state.load_average)
    versions = ", ".join(f"{name} {number}" for name, number in state.versions.items())
    console.print(f"{state.cpu}, {state.cores} cores, load average {load}, Python {state.python}, {versions}")
    if json_path is not None:
        rows = {row.part: {"cpu_ms": row.cost.cpu_ms, "wall_ms": row.cost.wall_ms} for row in costs}
        report = {"conditions": state.as_dict(), "width": width, "height": height, "parts": rows}
        write_figures(json_path, report)
