"""`ltm-lab bench render`: the cost of one simulated frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.resources import lab_config
from ltm_ros.cli.output import JsonFile


def render(
    scenario: Annotated[Path | None, typer.Argument(help="Scenario YAML; the demo's unless given.")] = None,
    near: Annotated[int, typer.Option(help="Near instances in the scene, at least.", min=0)] = 50_000,
    json_path: JsonFile = None,
) -> None:
    """Render one frame of a scenario: processor time, wall time, instances and peak memory."""
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.rendering import run_rendering
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.simulator.scenario_io import load_scenario

    console = Console()
    state = conditions(("mitsuba", "drjit", "numpy", "numba"))
    config = load_scenario(scenario or lab_config("scenarios/demo.yaml"))
    with console.status("rendering"):
        cost = run_rendering(config, near)
    table = Table(
        title=f"{config.name}: a frame of {cost.width} x {cost.height}, {cost.samples} samples, "
        f"{cost.instances} instances, {cost.near} of them near (within {cost.detail_radius:.0f} m or single plants)",
        caption=f"peak memory {cost.peak_mb:.0f} MB; on idle cores a frame takes its processor time over their number",
    )
    for column in ("", "cpu s", "wall s", f"cpu s / {state.cores} cores"):
        table.add_column(column, justify="left" if not column else "right")
    for name, part in (("site (once)", cost.site), ("scene (an eye point)", cost.scene), ("frame", cost.frame)):
        seconds = (part.cpu_ms / 1e3, part.wall_ms / 1e3, part.cpu_ms / 1e3 / state.cores)
        table.add_row(name, *(f"{value:.1f}" for value in seconds))
    console.print(table)
    load = " ".join(f"{value:.2f}" for value in state.load_average)
    versions = ", ".join(f"{name} {number}" for name, number in state.versions.items())
    console.print(f"{state.cpu}, {state.cores} cores, load average {load}, Python {state.python}, {versions}")
    if json_path is not None:
        write_figures(json_path, {"conditions": state.as_dict(), "cost": asdict(cost)})
