"""`ltm simulate`: render a scenario to pictures with truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def simulate(
    scenario: Annotated[Path, typer.Argument(help="Scenario YAML, such as config/scenarios/demo.yaml.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the frames; made if missing.")],
    first: Annotated[int, typer.Option(help="Number of the first frame to render (to go on after a stop).")] = 0,
    limit: Annotated[int | None, typer.Option(help="Render at most so many frames.")] = None,
    bag: Annotated[
        Path | None, typer.Option(help="Also write the frames as a recording (MCAP), with truth topics.")
    ] = None,
    site_only: Annotated[bool, typer.Option("--site-only", help="Write dem.tif and fuel_truth.tif only.")] = False,
) -> None:
    """Render SCENARIO: pictures, truth (ranges and labels), frames.json, the DEM handed to the system, the true
    fuel raster."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from ltm_core.simulator.output_io import write_frame, write_index, write_site
    from ltm_core.simulator.run import make_site, plan_shots, render_shots
    from ltm_core.simulator.scenario import load_scenario

    config = load_scenario(scenario)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns) as progress:
        task = progress.add_task(f"{config.name}: terrain and vegetation", total=None)
        site = make_site(config)
        write_site(out, config, site)
        if site_only:
            progress.update(task, total=0, description=f"{config.name}: site written to {out}")
            return
        shots = plan_shots(config, site)
        last = len(shots) if limit is None else min(len(shots), first + limit)
        progress.update(task, total=last - first, description=f"{config.name}: rendering")
        entries = []
        for number, frame in enumerate(render_shots(config, site, shots[first:last]), start=first):
            entries.append(write_frame(out, number, frame))
            write_index(out, config, entries)
            progress.update(task, completed=number + 1 - first)
        if bag is not None:
            from ltm_ros.simulated_bag import write_simulated_bag

            task = progress.add_task(f"{config.name}: recording {bag}", total=len(entries))
            write_simulated_bag(
                out, bag, config.name, progress=lambda done, total: progress.update(task, completed=done, total=total)
            )
