"""`ltm pose points`: fit a camera's pose and calibration to ground control points, and print the residuals."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, cast

import numpy as np
from typer import Argument, Option

from ltm_core.base.errors import PoseError
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.pictures import to_png
from ltm_core.pictures.trace import residual_picture
from ltm_core.pose_estimation.lens import LensPrior
from ltm_core.pose_estimation.points.resection import Resection, TracedErrors, resect, traced_errors
from ltm_core.pose_estimation.points.resection_adjustment import Parameter
from ltm_core.pose_estimation.points.resection_io import (
    ResectionSetup,
    held_notes,
    read_control_points,
    set_up_resection,
    write_pose,
    write_report,
)
from ltm_core.storage.config_io import load_yaml
from ltm_core.storage.disk_io import require_files
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.trace_io import GuessConfig, read_photo
from ltm_ros.cli.output import OptionalDems, Overwrite, Row, open_dems, print_table, say, warn

FirstPixel = Annotated[
    float, Option(metavar="PIXELS", help="Coordinate of the first pixel's centre: 0 (OpenCV), 1 (Matlab), 0.5.")
]
SigmaPx = Annotated[float, Option(metavar="PIXELS", help="Smallest standard deviation of a marked pixel.")]
"""Options of commands that read marked pixels."""


def points(
    control_points: Annotated[Path, Argument(metavar="POINTS", help="CSV: id, x, y, z (or lon, lat, z), u, v.")],
    guess: Annotated[Path, Option(metavar="FILE", help="Pose file with what is known: position and camera.")],
    out: Annotated[Path, Option("--out", "-o", metavar="FILE", help="Pose file to write, for `ltm trace`.")],
    dem: OptionalDems = None,
    free: Annotated[
        str | None,
        Option(metavar="NAMES", help="Fit focal, k1, k2, k3, centre, position, lens[:phone|ptz|action|slr], none."),
    ] = None,
    first_pixel: FirstPixel = 0.0,
    sigma_px: SigmaPx = 1.0,
    report: Annotated[Path | None, Option(metavar="FILE", help="JSON with residuals and covariance.")] = None,
    picture: Annotated[Path | None, Option(metavar="FILE", help="PNG of the residuals as arrows.")] = None,
    image: Annotated[Path | None, Option(metavar="FILE", help="Photo, background of --picture.")] = None,
    crs: Annotated[str | None, Option(help="CRS of the control points, if no DEM states it.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Fit a camera's pose and calibration to surveyed points that are marked in its photo."""
    require_files([place for place in (out, report, picture) if place is not None], overwrite)
    known = load_yaml(guess, GuessConfig)
    terrain = open_dems(dem, crs) if dem else None
    setup = set_up_resection(known, terrain, crs)
    marked = read_control_points(control_points, setup.frame, first_pixel)
    sigma = known.pose.sigmas_of_place()
    chosen = parameter_names(free) if free is not None else ["focal", "k1", *(["position"] if sigma else [])]
    kind = lens_kind(chosen)
    lens = LensPrior.of(kind, setup.camera) if kind else None
    if sigma and kind:
        chosen.append("position")

    bend = ray_bend(known.curvature, known.refraction)

    def fitted(names: list[str], pixels: float) -> Resection:
        free = cast("list[Parameter]", names)
        return resect(marked, setup.camera, setup.position, setup.angles_deg, free, bend, sigma, pixels, lens)

    def advice(outliers: int) -> str:
        return _what_fits(fitted, chosen, sigma_px, outliers, setup)

    try:
        result = fitted(chosen, sigma_px)
    except PoseError as error:
        raise PoseError(f"{error}{advice(len(marked.names))}") from error
    for place in (out, report, picture):
        if place is not None:
            place.parent.mkdir(parents=True, exist_ok=True)
    write_pose(out, result, known, setup.frame)
    if report is not None:
        write_report(report, result)
    if picture is not None:
        photo = read_photo(image, setup.camera) if image is not None else None
        picture.write_bytes(to_png(residual_picture(setup.camera, marked.pixels, result.residuals, result.used, photo)))
    for note in held_notes(result):
        warn(note)
    if result.outliers:
        warn(f"rejected as outliers: {', '.join(result.outliers)}{advice(len(result.outliers))}")
    _print_parameters(result, setup)
    _print_points(result, setup, known.curvature, known.refraction)
    say(f"  {out}")


def parameter_names(listed: str) -> list[str]:
    """Return the names of a comma-separated list of parameters to fit; none for `none`."""
    return [name.strip() for name in listed.split(",") if name.strip() not in ("", "none", "angles")]


def lens_kind(chosen: list[str]) -> str | None:
    """Take `lens` or `lens:KIND` out of the chosen parameters and return the kind, `any` without one; None: neither."""
    named = [name for name in chosen if name.partition(":")[0] == "lens"]
    for name in named:
        chosen.remove(name)
    return (named[0].partition(":")[2] or "any") if named else None


def _what_fits(
    fitted: Callable[[list[str], float], Resection],
    free: list[str],
    sigma_px: float,
    outliers: int,
    setup: ResectionSetup,
) -> str:
    """Return advice that fits more of the points: a free position, or less exact pixels. Empty: there is none."""
    free_place = free if "position" in free else [*free, "position"]
    for names, pixels in ((free_place, sigma_px), (free, 3 * sigma_px), (["position"], 2 * sigma_px)):
        try:
            result = fitted(names, pixels)
        except PoseError:
            continue
        if len(result.outliers) >= outliers or "position" in result.held:
            continue
        moved = float(np.linalg.norm(result.pose.position - setup.position))
        place = f" (the camera moves by {moved:.1f} m)" if "position" in names else ""
        return (
            f". With --free {','.join(names) or 'none'} --sigma-px {pixels:g}, {len(result.outliers)} points do not fit"
            f"{place}; if the position is not exact, state position_sigma in the guess"
        )
    return ""


def _print_parameters(result: Resection, setup: ResectionSetup) -> None:
    (azimuth, pitch, roll), camera, start, frame = result.pose.angles_deg, result.camera, setup.camera, setup.frame
    rows = []
    for name, value, given, digits, optional in (
        ("azimuth_deg", azimuth, None, 4, False),
        ("pitch_deg", pitch, None, 4, False),
        ("roll_deg", roll, None, 4, False),
        ("fx", camera.fx, start.fx, 2, False),
        ("k1", camera.distortion[0], start.distortion[0], 5, False),
        ("k2", camera.distortion[1], None, 5, True),
        ("k3", camera.distortion[4], None, 5, True),
        ("cx", camera.cx, None, 2, True),
        ("cy", camera.cy, None, 2, True),
        ("x", result.pose.position[0] + frame.x_origin, setup.position[0] + frame.x_origin, 2, False),
        ("y", result.pose.position[1] + frame.y_origin, setup.position[1] + frame.y_origin, 2, False),
        ("z", result.pose.position[2], setup.position[2], 2, False),
    ):
        sigma = result.sigmas.get(name)
        if sigma is not None or not optional:
            shown = "held" if sigma is None else f"{sigma:.3g}"
            rows.append((name, f"{value:.{digits}f}", shown, "" if given is None else f"{given:.{digits}f}"))
    print_table("camera", ("parameter", ">fitted", ">sigma", ">given"), rows)


def _print_points(result: Resection, setup: ResectionSetup, curvature: bool, refraction: float) -> None:
    title = f"{len(result.used)} points: median residual {np.median(result.residual_px):.2f} px"
    columns = ["point", ">u", ">v", ">du px", ">dv px", ">residual px"]
    traced = None
    x, y, z = (float(v) for v in result.pose.position)
    below = 0.0 if setup.dem is None else float(setup.dem.elevation_at(x, y)) - z
    if below > 0:
        warn(
            f"the fitted camera, at ({x + setup.frame.x_origin:.1f}, {y + setup.frame.y_origin:.1f}) in "
            f"{setup.frame.crs}, is {below:.1f} m below the DEM: `ltm trace` rejects it. Check the height of the guess "
            "and the vertical datums of points and DEM"
        )
    elif setup.dem is not None:
        traced = traced_errors(result, TerrainTracer(setup.dem, curvature, refraction))
        columns += [">trace error", ">over the DEM", "state in the DEM"]
        title += f"\n{_summary(traced)}"
    rows: list[Row] = []
    for k, name in enumerate(result.points.names):
        shown = (
            f"{value:.{digits}f}"
            for value, digits in zip(
                (*result.points.pixels[k], *result.residuals[k], result.residual_px[k]), (1, 1, 2, 2, 2), strict=True
            )
        )
        cells = [name, *shown]
        if traced is not None:
            off, above = float(traced.errors[k]), float(traced.above_ground[k])
            cells += [f"{off:.2f} m" if traced.met[k] else "no terrain", "" if np.isnan(above) else f"{above:+.1f} m"]
            cells.append(str(traced.states[k]))
        rows.append(cells if result.used[k] else [("red", cell) for cell in cells])
    print_table(title, columns, rows)


def _summary(traced: TracedErrors) -> str:
    """Return the median distance between traced and surveyed places, of the points that meet terrain."""
    met, seen = traced.met, traced.met & traced.visible
    if not met.any():
        return "no marked pixel meets known terrain: check the DEM and the camera's position"
    said = f"traced against surveyed: median {np.median(traced.errors[met]):.2f} m"
    if not met.all():
        said += f" of {met.sum()} points ({(~met).sum()} meet no known terrain)"
    if seen.any():
        said += f", {np.median(traced.errors[seen]):.2f} m for the {seen.sum()} that are visible on the DEM"
    return said
