"""`ltm-lab simulate`: renders a scenario to pictures with truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ltm_ros.cli.output import writable_folder


def simulate(
    scenario: Annotated[Path, typer.Argument(help="Scenario YAML, such as ltm_lab/config/scenarios/demo.yaml.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for the frames; made if missing.", callback=writable_folder)
    ],
    first: Annotated[int, typer.Option(help="Number of the first frame to render (to go on after a stop).")] = 0,
    limit: Annotated[int | None, typer.Option(help="Render at most so many frames.")] = None,
    bag: Annotated[
        Path | None,
        typer.Option(
            help="Also write the frames as a recording (MCAP) with truth topics; of several such dates, in BAG/DATE."
        ),
    ] = None,
    phone: Annotated[
        Path | None,
        typer.Option(help="Also write the scenario's walk as a phone stores it: photos, sensor recording, true poses."),
    ] = None,
    site_only: Annotated[bool, typer.Option("--site-only", help="Write the rasters only.")] = False,
) -> None:
    """Render SCENARIO: pictures with truth (ranges, labels), frames.json, the DEM handed to the system, and true
    rasters of every date with what changed between them."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from ltm_core.base.errors import ConfigError
    from ltm_lab.simulator.output_io import write_change, write_frame, write_index, write_site, write_truth
    from ltm_lab.simulator.run import make_site, plan_shots, rasters_at, render_shots, site_at
    from ltm_lab.simulator.scenario_io import load_scenario, located

    config = load_scenario(scenario)
    if bag is not None:
        _require_free(bag, [date.name for date in config.dates if date.frames])
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns) as progress:
        task = progress.add_task(f"{config.name}: terrain and vegetation", total=None)
        try:
            site = make_site(config)
            standing = site_at(config, site, config.dates[0])
            plan_shots(config, standing)
        except ConfigError as error:
            raise located(scenario, error) from error
        jobs = []
        before = None
        for i, date in enumerate(config.dates):
            progress.update(task, description=f"{config.name}: truth of {date.name}")
            here, dated = config.at(date), site_at(config, site, date)
            truth = rasters_at(here, dated)
            write_truth(out, date.name, here, dated, truth)
            if before is None:
                write_site(out, config, dated, truth)
            else:
                write_change(out, (config.dates[i - 1].name, date.name), before, truth)
            before = truth
            if date.frames:
                jobs.append((here, dated, plan_shots(config, standing, date)))
        if site_only:
            progress.update(task, total=0, description=f"{config.name}: site written to {out}")
            return
        total = sum(len(shots) for _, _, shots in jobs)
        last = total if limit is None else min(total, first + limit)
        progress.update(task, total=last - first, description=f"{config.name}: rendering")
        entries: list[dict[str, Any]] = []
        begin = 0
        for here, dated, shots in jobs:
            wanted = shots[max(0, first - begin) : max(0, last - begin)]
            try:
                for number, frame in enumerate(render_shots(here, dated, wanted), start=max(first, begin)):
                    entries.append(write_frame(out, number, frame))
                    write_index(out, config, entries)
                    progress.update(task, completed=len(entries))
            except ConfigError as error:
                raise located(scenario, error) from error
            begin += len(shots)
        if phone is not None:
            from ltm_lab.evaluation.phone_capture import write_phone_capture

            task = progress.add_task(f"{config.name}: photos in {phone}", total=None)
            write_phone_capture(out, phone, lambda done, total: progress.update(task, completed=done, total=total))
        if bag is not None:
            from ltm_lab.evaluation.simulated_bag import write_simulated_bag

            pictured = [date for date in config.dates if date.frames]
            for date in pictured:
                place = bag if len(pictured) == 1 else bag / date.name
                task = progress.add_task(f"{config.name}: recording {place}", total=None)

                def show(done: int, total: int, task: TaskID = task) -> None:
                    progress.update(task, completed=done, total=total)

                write_simulated_bag(out, place, config.name, progress=show, date=date.name)


def _require_free(bag: Path, pictured: list[str]) -> None:
    """Before anything is rendered. `pictured`: names of the dates with frames, of which each has a bag."""
    from ltm_msgs_py.bag.writer import BagWriter

    for place in [bag] if len(pictured) == 1 else [bag / name for name in pictured]:
        BagWriter.require_free(place)
