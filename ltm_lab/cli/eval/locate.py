"""`ltm-lab eval locate`: scores located places against smoke of known place, and against surveyed control points."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ltm_ros.cli.output import JsonFile, writable_folder

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_core.raster.dem import Dem
    from ltm_lab.evaluation.locating.smoke_score import Case, Trial

HELD_OUT = "31,32,33,34"
"""Seeds of synthetic sites that no constant of locating was chosen on: those were chosen on seeds 1 and 2."""


def locate(
    seeds: Annotated[str, typer.Option(help="Synthetic sites of 20 km; commas. Empty: none.")] = HELD_OUT,
    dem: Annotated[
        list[Path] | None, typer.Option(help="Instead: real terrain, an elevation raster a site. Repeatable.")
    ] = None,
    count: Annotated[int, typer.Option(help="Trials of each case on each site.", min=1)] = 60,
    angle_sigma: Annotated[float, typer.Option(help="Degrees by which each angle of a pose is off.", min=0.001)] = 0.06,
    dem_error: Annotated[
        float | None, typer.Option(help="Sigma of the terrain model's heights, metres; default a tenth of a cell.")
    ] = None,
    marks: Annotated[str, typer.Option(help="What is marked: click, box, or both.")] = "both",
    cases: Annotated[str, typer.Option(help="Of one, two, same, three, turned; commas.")] = "one,two,same,three,turned",
    fires: Annotated[
        int, typer.Option(help="Instead: three cameras, one or none of them turned, mark so many fires; who is named.")
    ] = 0,
    draw: Annotated[int, typer.Option(help="With --dem: each number has other cases on the same rasters.", min=0)] = 0,
    frames: Annotated[
        list[Path] | None,
        typer.Option(help="Instead: folders of `ltm-lab simulate`, whose eyes are three watched cameras. Repeatable."),
    ] = None,
    points: Annotated[
        Path | None, typer.Option(help="Instead: control points, a CSV with id, x, y, z, u, v; with --guess and --dem.")
    ] = None,
    guess: Annotated[Path | None, typer.Option(help="With --points: pose file of what is known of the camera.")] = None,
    first_pixel: Annotated[float, typer.Option(help="With --points: number of the first pixel's centre.")] = 0.0,
    speed: Annotated[bool, typer.Option("--speed", help="Instead: time of queries on 10,000 x 10,000 cells.")] = False,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for a picture of the first trials of each.", callback=writable_folder)
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Error of located places, and whether their regions hold the truth: one camera, two, and three with a wrong one.

    Smoke is geometric: a leaning plume over known ground, seen by lines of sight; no picture is rendered.
    """
    from rich.console import Console

    from ltm_core.base.errors import ConfigError

    console = Console()
    if speed:
        _speed(console, json_path)
        return
    if frames:
        from ltm_lab.cli.eval.locate_watched import watched

        watched(frames, count, angle_sigma, dem_error, draw, console, json_path)
        return
    if points is not None:
        if guess is None or not dem:
            raise ConfigError("--points needs --guess, a pose file of what is known, and --dem")
        _points(points, guess, dem[0], first_pixel, dem_error, console, json_path)
        return
    if fires > 0:
        from ltm_lab.cli.eval.locate_turned import naming

        naming(_sites(seeds, dem or [], draw), count, fires, angle_sigma, dem_error, console, json_path)
        return
    if marks not in ("click", "box", "both"):
        raise ConfigError(f"--marks is click, box or both, got {marks!r}")
    from ltm_lab.evaluation.locating.smoke_score import Case

    unknown = [part for part in cases.split(",") if part.upper() not in Case.__members__]
    if unknown:
        raise ConfigError(f"--cases are one, two, same, three, turned, got {', '.join(unknown)}")
    chosen = tuple(Case[part.upper()] for part in cases.split(","))
    boxed = {"click": [False], "box": [True], "both": [False, True]}[marks]
    _smoke(_sites(seeds, dem or [], draw), chosen, count, angle_sigma, dem_error, boxed, pictures, console, json_path)


def _sites(seeds: str, rasters: list[Path], draw: int) -> list[tuple[str, Dem, int]]:
    from ltm_core.base.errors import ConfigError
    from ltm_core.raster.dem import Dem
    from ltm_lab.evaluation.locating.smoke_sites import ranged_mountains

    if rasters:
        return [(path.parent.name + "/" + path.stem, Dem.open(path), draw + k) for k, path in enumerate(rasters)]
    try:
        numbers = [int(part) for part in seeds.split(",") if part]
    except ValueError as error:
        raise ConfigError(f"--seeds must be whole numbers with commas, got {seeds!r}") from error
    return [(f"seed {number}", ranged_mountains(number), number) for number in numbers]


def _smoke(
    sites: list[tuple[str, Dem, int]],
    cases: tuple[Case, ...],
    count: int,
    angle_sigma: float,
    dem_error: float | None,
    boxed: list[bool],
    pictures: Path | None,
    console: Console,
    json_path: Path | None,
) -> None:
    from ltm_core.locating.settings import LocatingConfig
    from ltm_lab.bench.measure import conditions
    from ltm_lab.evaluation.locating.smoke_score import smoke_trials
    from ltm_lab.evaluation.locating.smoke_sites import smoke_site
    from ltm_lab.evaluation.locating.smoke_trials import PoseErrors
    from ltm_ros.pages.figures_io import write_figures

    machine = conditions(("numpy", "numba", "scipy"))
    console.print(
        f"{machine.cpu}, {machine.cores} cores. Geometric smoke (no picture is rendered), 0.8 to 10 km away, height "
        f"120 m median; 1920 x 1080 at 60 deg; sigma of each angle {angle_sigma:g} deg, of the position 0.5 m; "
        f"{count} trials a case and site",
        highlight=False,
    )
    trials: list[Trial] = []
    with console.status("looking") as status:
        for name, dem, seed in sites:
            error = 0.1 * dem.geometry.resolution if dem_error is None else dem_error
            site = smoke_site(name, dem, error, seed)
            config = LocatingConfig(dem_sigma=error)
            for kind in boxed:
                for case in cases:
                    status.update(f"{name}, {case.value}, {'box' if kind else 'click'}")
                    drawer = None if pictures is None else _drawer(pictures, name, case.value, kind, site.model)
                    trials += smoke_trials(
                        site, (case,), count, PoseErrors(angle_sigma), config, kind, seed, drawer=drawer
                    )
    for kind in boxed:
        console.print(_table(trials, kind))
    if json_path is not None:
        write_figures(json_path, [trial.row() for trial in trials])
        console.print(f"  {json_path}", highlight=False)


def _table(trials: list[Trial], boxed: bool) -> Any:
    """A column a case: there are more figures than a line has room for."""
    from rich.table import Table

    from ltm_lab.evaluation.locating.smoke_score import Case
    from ltm_lab.evaluation.locating.summary import SmokeSummary

    groups: dict[str, list[Trial]] = {}
    for case in Case:
        here = [trial for trial in trials if trial.case == case.value and trial.boxed == boxed]
        if case is Case.ONE:
            groups[f"{case.value}, foot seen"] = [trial for trial in here if trial.hidden == 0]
            groups[f"{case.value}, foot hidden"] = [trial for trial in here if trial.hidden > 0]
        else:
            groups[case.value] = here
    scores = {name: one for name, group in groups.items() if (one := SmokeSummary.of(group)) is not None}
    table = Table(title="a detector's box is marked" if boxed else "the lowest visible smoke is clicked on")
    for column in ("", *scores):
        table.add_column(column, justify="right" if column else "left")
    lines: dict[str, Callable[[SmokeSummary], str]] = {
        "trials, refused": lambda one: f"{one.count}, {one.unlocated}",
        "range, median": lambda one: f"{one.range / 1000:.1f} km",
        "mean place off, median": lambda one: f"{one.error:.0f} m",
        "of range": lambda one: f"{one.error_share:.2%}",
        "90 %": lambda one: f"{one.error_p90:.0f} m",
        "likeliest place off, median": lambda one: f"{one.likeliest_error:.0f} m",
        "of range ": lambda one: f"{one.likeliest_share:.2%}",
        "in the 50 %, 95 % ellipse": lambda one: f"{one.ellipse_50:.0%}, {one.ellipse_95:.1%}",
        "in the densest 50 %, 95 %": lambda one: f"{one.densest_50:.0%}, {one.densest_95:.1%}",
        "95 % ellipse, half axes": lambda one: f"{one.long:.0f} x {one.short:.0f} m",
        "taken for agreeing": lambda one: f"{one.agreed:.1%}",
        "wrong camera named": lambda one: "" if one.named != one.named else f"{one.named:.1%}",
        "right camera named": lambda one: f"{one.wrongly_named:.1%}",
        "wall time, median": lambda one: f"{one.milliseconds:.0f} ms",
    }
    for name, shown in lines.items():
        table.add_row(name, *(shown(one) for one in scores.values()))
    return table


def _drawer(folder: Path, site: str, case: str, boxed: bool, dem: Dem) -> Any:
    """Draws the first trials of a case."""
    from ltm_core.pictures import MapCamera, to_png
    from ltm_core.pictures.locating import location_picture

    drawn = 0

    def draw(location: Any, sightings: Any, truth: tuple[float, float]) -> None:
        nonlocal drawn
        if drawn == 2:
            return
        drawn += 1
        cameras = []
        for sighting in sightings:
            x, y, _ = (float(v) for v in sighting.pose.position)
            cameras.append(MapCamera(sighting.name, sighting.camera, (x, y), sighting.pose.angles_deg[0]))
        ellipses = [(f"{share:.0%}", location.posterior.ellipse(share)) for share in (0.5, 0.95)]
        titles = (f"{site}: {case}", "green: the truth")
        picture = location_picture(dem, location.posterior, ellipses, cameras, (0.0, 0.0), titles, truth)
        folder.mkdir(parents=True, exist_ok=True)
        words = f"{site} {case} {'box' if boxed else 'click'} {drawn}".replace(",", "").replace("/", " ")
        (folder / f"{words.replace(' ', '_')}.png").write_bytes(to_png(picture))

    return draw


def _points(
    points: Path,
    guess: Path,
    raster: Path,
    first_pixel: float,
    dem_error: float | None,
    console: Console,
    json_path: Path | None,
) -> None:
    import numpy as np
    from rich.table import Table

    from ltm_core.geometry.geodesy import ray_bend
    from ltm_core.locating.settings import LocatingConfig
    from ltm_core.pose_estimation.points.resection_io import read_control_points, set_up_resection
    from ltm_core.raster.dem_stack import open_terrain
    from ltm_core.storage.config_io import load_yaml
    from ltm_core.tracing.trace_io import GuessConfig
    from ltm_lab.evaluation.locating.control_points import located_points
    from ltm_ros.pages.figures_io import write_figures

    known = load_yaml(guess, GuessConfig)
    setup = set_up_resection(known, open_terrain([(raster, None)]), None)
    assert setup.dem is not None  # nosec B101 # tells the type checker what holds
    read = read_control_points(points, setup.frame, first_pixel)
    config = LocatingConfig() if dem_error is None else LocatingConfig(dem_sigma=dem_error)
    bend = ray_bend(known.curvature, known.refraction)
    with console.status("locating"):
        found = list(located_points(read, setup.camera, setup.position, setup.dem, bend, config))
    table = Table(title=f"each point by the others' pose; sigma of the terrain's heights {config.dem_sigma:g} m")
    columns = (
        "point", "range m", "mean off m", "likeliest off m", "traced off m", "densest share", "in 50 %", "in 95 %",
        "half axes m",
    )  # fmt: skip
    for column in columns:
        table.add_column(column, justify="left" if column == "point" else "right")
    for point in found:
        table.add_row(
            point.name,
            f"{point.range:.0f}",
            point.unlocated or f"{point.error:.1f}",
            f"{point.likeliest_error:.1f}",
            f"{point.traced_error:.1f}",
            f"{point.densest:.2f}",
            "yes" if point.in_50 else "no",
            "yes" if point.in_95 else "no",
            f"{point.major:.0f} x {point.minor:.1f}",
        )
    console.print(table)
    errors = [point.error for point in found if not point.unlocated]
    likeliest = [point.likeliest_error for point in found]
    console.print(
        f"median error {np.median(errors):.2f} m, of the likeliest place {np.nanmedian(likeliest):.2f} m, traced "
        f"{np.nanmedian([p.traced_error for p in found]):.2f} m; the "
        f"ellipses hold {np.mean([p.in_50 for p in found]):.0%} (50), {np.mean([p.in_95 for p in found]):.0%} (95 %), "
        f"the densest regions {np.mean([p.densest < 0.5 for p in found]):.0%}, "
        f"{np.mean([p.densest < 0.95 for p in found]):.0%} of {len(found)} points",
        highlight=False,
    )
    if json_path is not None:
        write_figures(json_path, [point.row() for point in found])


def _speed(console: Console, json_path: Path | None) -> None:
    from dataclasses import asdict

    from rich.table import Table

    from ltm_lab.bench.measure import conditions
    from ltm_lab.evaluation.locating.speed import large_stack, query_times
    from ltm_ros.pages.figures_io import write_figures

    machine = conditions(("numpy", "numba", "scipy"))
    with console.status("terrain"):
        dem = large_stack()
    with console.status("queries"):
        times = query_times(dem)
    table = Table(title=f"a query on 10,000 x 10,000 cells of 1 m, 25 m to 40 km; {machine.cpu}, {machine.cores} cores")
    for column in ("query", "wall ms, median", "CPU ms", "queries"):
        table.add_column(column, justify="left" if column == "query" else "right")
    for each in times:
        table.add_row(each.query, f"{each.wall:.1f}", f"{each.cpu:.1f}", str(each.count))
    console.print(table)
    if json_path is not None:
        write_figures(json_path, [asdict(each) for each in times])
