"""`ltm-lab eval locate`: scores located places against smoke at known places, and against surveyed control points."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_lab.cli.eval.trial_runner import Processes
from ltm_lab.options import JsonFile

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_lab.evaluation.locating.control_points import LocatedPoint
    from ltm_lab.evaluation.locating.smoke_score import SmokeTrial

HELD_OUT = "31,32,33,34"
"""Seeds of synthetic sites on which no constant of locating was chosen; those were chosen on seeds 1 and 2."""


def locate(
    seeds: Annotated[str, typer.Option(help="Seeds of synthetic sites of 20 km, separated by commas.")] = HELD_OUT,
    dem: Annotated[
        list[Path] | None, typer.Option(help="Real terrain, one raster for each site, instead. Repeatable.")
    ] = None,
    count: Annotated[int, typer.Option(help="Number of trials of each case on each site.", min=1)] = 60,
    angle_sigma: Annotated[float, typer.Option(help="Sigma of each angle of a pose, degrees.", min=0.001)] = 0.06,
    dem_error: Annotated[
        float | None, typer.Option(help="Sigma of the terrain's heights, metres. Default: a tenth of a cell.")
    ] = None,
    marks: Annotated[str, typer.Option(help="Kind of marks: click, box or both.")] = "both",
    cases: Annotated[str, typer.Option(help="Cases, separated by commas.")] = "one,two,same,three,turned",
    frames: Annotated[
        list[Path] | None, typer.Option(help="Folder of `ltm-lab simulate`, whose cameras mark, instead. Repeatable.")
    ] = None,
    draw: Annotated[int, typer.Option(help="Seed of the trials on --dem or --frames.", min=0)] = 0,
    points: Annotated[
        Path | None, typer.Option(help="CSV of control points (id, x, y, z, u, v). Needs --guess and --dem.")
    ] = None,
    guess: Annotated[Path | None, typer.Option(help="Pose file of what is known of the camera of --points.")] = None,
    first_pixel: Annotated[float, typer.Option(help="Number of the first pixel's centre in --points.")] = 0.0,
    processes: Processes = 1,
    json_path: JsonFile = None,
) -> None:
    """Score the error of located places and whether their regions hold the truth.

    Smoke is geometric: a leaning plume over known ground, seen by lines of sight. One, two or three cameras mark it,
    one of which may be turned.
    """
    from rich.console import Console

    from ltm_core.base.errors import ConfigError
    from ltm_lab.bench.measure import conditions
    from ltm_lab.cli.eval.trial_runner import report, run_trials
    from ltm_lab.evaluation.locating.smoke_score import Case, SmokeJob, run_smoke_job

    console = Console()
    if points is not None:
        if guess is None or not dem:
            raise ConfigError("--points has no camera and terrain: give --guess, a pose file, and --dem")
        found, sigma = _located(points, guess, dem, first_pixel, dem_error)
        _print_points(console, found)
        report(console, f"each point by the others' pose; sigma of the heights {sigma:g} m", found, json_path)
        return
    boxed = {"click": (False,), "box": (True,), "both": (False, True)}.get(marks)
    if boxed is None:
        raise ConfigError(f"--marks is {marks!r}; give click, box or both")
    unknown = [part for part in cases.split(",") if part.upper() not in Case.__members__]
    if unknown:
        raise ConfigError(f"--cases has {', '.join(unknown)}; give one, two, same, three, turned")
    chosen = tuple(Case[part.upper()] for part in cases.split(","))
    try:
        numbers = [int(part) for part in seeds.split(",") if part]
    except ValueError as error:
        raise ConfigError(f"--seeds is {seeds!r}; give whole numbers separated by commas") from error
    sites: list[tuple[int, Path | None]] = [*enumerate([*(dem or []), *(frames or [])], draw)]
    sites = sites or [(number, None) for number in numbers]
    jobs = [SmokeJob(path, seed, chosen, boxed, count, angle_sigma, dem_error) for seed, path in sites]
    trials = run_trials(run_smoke_job, jobs, processes, console)
    for kind in boxed:
        _print_smoke(console, [trial for trial in trials if trial.boxed == kind], kind)
    machine = conditions(("numpy", "numba", "scipy"))
    state = (
        f"{machine.cpu}, {machine.cores} cores. Geometric smoke (no image is rendered), 0.8 to 10 km away, height "
        f"120 m median; 1920 x 1080 at 60 deg; sigma of each angle {angle_sigma:g} deg, of the position 0.5 m; "
        f"{count} trials a case and site"
    )
    report(console, state, trials, json_path)


def _print_smoke(console: "Console", trials: "Sequence[SmokeTrial]", boxed: bool) -> None:
    """Print a column for each case: there are more figures than a line has room for."""
    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.evaluation.locating.smoke_score import Case, SmokeSummary

    groups: dict[str, list[SmokeTrial]] = {}
    for case in Case:
        here = [trial for trial in trials if trial.case == case]
        if case is Case.ONE:
            groups[f"{case}, foot seen"] = [trial for trial in here if trial.hidden == 0]
            groups[f"{case}, foot hidden"] = [trial for trial in here if trial.hidden > 0]
        else:
            groups[case] = here
    scores = {name: SmokeSummary.of(group) for name, group in groups.items() if group}
    lines = {
        "trials, rejected": "{0.count}, {0.unlocated}",
        "range, median": "{0.range_km:.1f} km",
        "mean place off, median": "{0.error:.0f} m",
        "of range": "{0.error_share:.2%}",
        "90 %": "{0.error_p90:.0f} m",
        "likeliest place off, median": "{0.likeliest_error:.0f} m",
        "of range ": "{0.likeliest_share:.2%}",
        "in the 50 %, 95 % ellipse": "{0.ellipse_50:.0%}, {0.ellipse_95:.1%}",
        "in the densest 50 %, 95 %": "{0.densest_50:.0%}, {0.densest_95:.1%}",
        "95 % ellipse, half axes": "{0.major:.0f} x {0.minor:.0f} m",
        "taken to agree": "{0.agreed:.1%}",
        "turned camera suspected": "{0.suspected:.1%}",
        "wall time, median": "{0.milliseconds:.0f} ms",
    }
    rows = [
        (name, *(text.format(score).replace("nan%", "") for score in scores.values())) for name, text in lines.items()
    ]
    title = "a detector's box is marked" if boxed else "the lowest visible smoke is clicked on"
    print_table(console, title, ("", *scores), rows)


def _located(
    points: Path, guess: Path, rasters: Sequence[Path], first_pixel: float, dem_error: float | None
) -> "tuple[list[LocatedPoint], float]":
    """Return the located points and the sigma of the terrain's heights."""
    from ltm_core.geometry.geodesy import ray_bend
    from ltm_core.locating.settings import LocatingConfig
    from ltm_core.pose_estimation.points.resection_io import read_control_points, set_up_resection
    from ltm_core.raster.dem_stack import open_terrain
    from ltm_core.storage.config_io import load_yaml
    from ltm_core.tracing.trace_io import GuessConfig
    from ltm_lab.evaluation.locating.control_points import located_points

    known = load_yaml(guess, GuessConfig)
    setup = set_up_resection(known, open_terrain([(raster, None) for raster in rasters]), None)
    assert setup.dem is not None  # nosec B101 # tells the type checker what holds
    read = read_control_points(points, setup.frame, first_pixel)
    config = LocatingConfig() if dem_error is None else LocatingConfig(dem_sigma=dem_error)
    bend = ray_bend(known.curvature, known.refraction)
    return located_points(read, setup.camera, setup.position, setup.dem, bend, config), config.dem_sigma


def _print_points(console: "Console", found: "Sequence[LocatedPoint]") -> None:
    import numpy as np

    from ltm_lab.cli.eval.score_table import print_table

    columns = ("point", "range m", "mean off m", "likeliest off m", "traced off m", "densest share", "in 50 %",
               "in 95 %", "half axes m")  # fmt: skip
    rows = [
        (point.name, f"{point.range:.0f}", p.unlocated or f"{p.error:.1f}", f"{p.likeliest_error:.1f}",
         f"{point.traced_error:.1f}", f"{p.densest:.2f}", "yes" if p.in_50 else "no", "yes" if p.in_95 else "no",
         f"{p.major:.0f} x {p.minor:.1f}")
        for point in found for p in (point.place,)
    ]  # fmt: skip
    print_table(console, "control points", columns, rows)
    places = [point.place for point in found]
    console.print(
        f"median error {np.nanmedian([p.error for p in places]):.2f} m, of the likeliest place "
        f"{np.nanmedian([p.likeliest_error for p in places]):.2f} m, traced "
        f"{np.nanmedian([point.traced_error for point in found]):.2f} m; the ellipses hold "
        f"{np.mean([p.in_50 for p in places]):.0%} (50), {np.mean([p.in_95 for p in places]):.0%} (95 %), the densest "
        f"regions {np.mean([p.densest < 0.5 for p in places]):.0%}, {np.mean([p.densest < 0.95 for p in places]):.0%} "
        f"of {len(found)} points",
        highlight=False,
    )
