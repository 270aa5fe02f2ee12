"""`ltm-lab simulate`: renders a scenario to images with truth."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from ltm_lab.options import writable_folder


def simulate(
    scenario: Annotated[
        str, typer.Argument(help="Scenario YAML, or a kind: tower, pose, training, felled, conversion, change.")
    ] = "",
    *,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for the frames; created if missing.", callback=writable_folder)
    ],
    seed: Annotated[int | None, typer.Option(help="Seed that draws a scenario of the given kind.")] = None,
    first: Annotated[int, typer.Option(help="Number of the first frame, to continue after a stop.")] = 0,
    limit: Annotated[int | None, typer.Option(help="Maximum number of frames.")] = None,
    bag: Annotated[
        Path | None, typer.Option(help="Also write a recording (MCAP) with truth; several dates in BAG/DATE.")
    ] = None,
    phone: Annotated[
        Path | None, typer.Option(help="Also write the walk as a phone stores it: photos, sensors, true poses.")
    ] = None,
    site_only: Annotated[bool, typer.Option("--site-only", help="Write only the rasters.")] = False,
    site_file: Annotated[
        Path | None, typer.Option("--site", help="Site file: render the views of its cameras instead of a scenario.")
    ] = None,
    photos: Annotated[
        Path | None, typer.Option(help="With --site: recording, or folder of photos named by camera, to pair.")
    ] = None,
    samples: Annotated[int, typer.Option(min=1, help="With --site: light paths a pixel.")] = 24,
) -> None:
    """Render a scenario: images with truth (ranges, labels), frames.json, the DEM that the system is given, and the
    true rasters of each date with the changes between dates. Or what the cameras of a real site see over its own DEM
    and fuel map, for `ltm-lab eval sim2real OUT/real OUT/simulated`."""
    from rich.progress import MofNCompleteColumn, Progress, TaskID

    from ltm_core.base.errors import ConfigError
    from ltm_core.storage.config_io import load_yaml
    from ltm_lab.evaluation.phone_capture import write_phone_capture
    from ltm_lab.evaluation.simulated_bag import write_simulated_bag
    from ltm_lab.simulator.output_io import (
        write_change,
        write_frame,
        write_index,
        write_scenario,
        write_site,
        write_truth,
    )
    from ltm_lab.simulator.run import make_site, plan_shots, rasters_at, render_shots, site_at
    from ltm_lab.simulator.scenario import Scenario
    from ltm_lab.simulator.scenario_draw import KINDS, draw_scenario
    from ltm_msgs_py.bag.writer import BagWriter

    if site_file is not None:
        _render_site(site_file, out, photos, samples, limit)
        return
    if not scenario:
        raise ConfigError("give a scenario, or a site with --site")
    if seed is not None:
        config = draw_scenario(scenario, seed)
        write_scenario(out, config)
    elif scenario in KINDS:
        raise ConfigError(f"{scenario} is a kind of scenario; give its --seed, such as --seed 31")
    else:
        config = load_yaml(scenario, Scenario)
    rendered = [date.name for date in config.dates if date.frames]
    bags = {} if bag is None else {name: bag if len(rendered) == 1 else bag / name for name in rendered}
    for place in bags.values():
        BagWriter.require_free(place)
    with Progress(*Progress.get_default_columns(), MofNCompleteColumn()) as progress:
        task = progress.add_task(f"{config.name}: terrain and vegetation", total=None)
        site = make_site(config)
        standing = site_at(config, site, config.dates[0])
        jobs = []
        before = None
        for i, date in enumerate(config.dates):
            progress.update(task, description=f"{config.name}: truth of {date.name}")
            dated = site_at(config, site, date)
            truth = rasters_at(config, dated)
            write_truth(out, date.name, config, dated, truth)
            if before is None:
                write_site(out, config, dated, truth)
            else:
                write_change(out, (config.dates[i - 1].name, date.name), before, truth)
            before = truth
            if date.frames:
                jobs.append((dated, plan_shots(config, standing, date)))
        if site_only:
            progress.update(task, total=0, description=f"{config.name}: site written to {out}")
            return
        total = sum(len(shots) for _, shots in jobs)
        last = total if limit is None else min(total, first + limit)
        progress.update(task, total=last - first, description=f"{config.name}: rendering")
        entries: list[dict[str, Any]] = []
        begin = 0
        for dated, shots in jobs:
            wanted = shots[max(0, first - begin) : max(0, last - begin)]
            for number, frame in enumerate(render_shots(config, dated, wanted), start=max(first, begin)):
                entries.append(write_frame(out, number, frame))
                write_index(out, config, entries)
                progress.update(task, completed=len(entries))
            begin += len(shots)

        def show(task: TaskID, done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        if phone is not None:
            task = progress.add_task(f"{config.name}: photos in {phone}", total=None)
            write_phone_capture(out, phone, partial(show, task))
        for name, place in bags.items():
            task = progress.add_task(f"{config.name}: recording {place}", total=None)
            write_simulated_bag(out, place, config.name, progress=partial(show, task), date=name)


def _render_site(site_file: Path, out: Path, photos: Path | None, samples: int, limit: int | None) -> None:
    """Write OUT/simulated/NAME.png for each camera; or for each photo, beside the photo at that size in OUT/real."""
    from itertools import groupby

    import numpy as np
    from PIL import Image
    from rich.progress import Progress

    from ltm_core.site.site_io import load_site
    from ltm_lab.frames.posed_photos import photos_with_views
    from ltm_lab.simulator.real_site import Rendered, scenario_of, simulated_site, views_of
    from ltm_lab.simulator.run import render_shots

    site = load_site(site_file)
    dem = site.open_dem()
    wanted: list[Rendered] = []
    if photos is None:
        wanted = [Rendered.of(view.name, view, dem) for view in views_of(site, dem)][:limit]
    else:
        (out / "real").mkdir(parents=True, exist_ok=True)
        for name, view, photo in photos_with_views(photos, site, site_file, dem, limit):
            wanted.append(Rendered.of(name, view, dem))
            wanted[-1].like(photo).save(out / "real" / f"{name}.png")
    (out / "simulated").mkdir(parents=True, exist_ok=True)
    scenario = scenario_of(site, samples)
    with Progress() as progress:
        task = progress.add_task("rendering", total=len(wanted))
        for place, group in groupby(sorted(wanted, key=lambda one: one.place), lambda one: one.place):
            standing = list(group)
            ground = simulated_site(site, dem, np.asarray(place))
            for one, frame in zip(
                standing, render_shots(scenario, ground, [one.shot for one in standing]), strict=True
            ):
                Image.fromarray(frame.image).save(out / "simulated" / f"{one.name}.png")
                progress.advance(task)
