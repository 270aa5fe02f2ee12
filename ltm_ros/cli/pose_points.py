"""`ltm pose points`: fit a camera's pose and calibration to ground control points, and print the residuals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import Overwrite, open_dems, print_table

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_core.geometry.camera import Camera
    from ltm_core.pose_estimation.points.resection import Resection, TracedErrors
    from ltm_core.pose_estimation.points.resection_io import ResectionSetup


FirstPixel = Annotated[
    float, typer.Option(metavar="PIXELS", help="Coordinate of the first pixel's centre: 0 (OpenCV), 1 (Matlab), 0.5.")
]
SigmaPx = Annotated[float, typer.Option(metavar="PIXELS", help="Smallest standard deviation of a marked pixel.")]
"""Options of commands that read marked pixels."""


def points(
    control_points: Annotated[
        Path, typer.Argument(metavar="POINTS", help="CSV of control points: id, x, y, z (or lon, lat, z), u, v.")
    ],
    guess: Annotated[Path, typer.Option(metavar="FILE", help="Pose file with what is known: position and camera.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="Pose file to write, for `ltm trace`.")],
    dem: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="Elevation raster; repeat for coarser surrounding ones.")
    ] = None,
    free: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Also fit focal, k1, k2, k3, centre, position, lens, lens:phone (ptz, action, slr), or none.",
        ),
    ] = None,
    first_pixel: FirstPixel = 0.0,
    sigma_px: SigmaPx = 1.0,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="JSON with residuals and covariance.")] = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="PNG of the residuals as arrows.")] = None,
    image: Annotated[Path | None, typer.Option(metavar="FILE", help="Photo, background of --picture.")] = None,
    crs: Annotated[str | None, typer.Option(help="CRS of the control points, if no DEM states it.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Fit a camera's pose and calibration to surveyed points that are marked in its photo."""
    from typing import cast

    from rich.console import Console
    from rich.markup import escape

    from ltm_core.base.errors import PoseError
    from ltm_core.geometry.geodesy import ray_bend
    from ltm_core.pose_estimation.lens import LensPrior
    from ltm_core.pose_estimation.points.resection import resect
    from ltm_core.pose_estimation.points.resection_adjustment import Parameter
    from ltm_core.pose_estimation.points.resection_io import (
        held_notes,
        read_control_points,
        set_up_resection,
        write_pose,
        write_report,
    )
    from ltm_core.storage.config_io import load_yaml
    from ltm_core.storage.disk_io import require_files
    from ltm_core.tracing.trace_io import GuessConfig

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

    def fitted(names: list[str], pixels: float) -> Resection:
        return resect(
            marked,
            setup.camera,
            setup.position,
            setup.angles_deg,
            cast("list[Parameter]", names),
            ray_bend(known.curvature, known.refraction),
            sigma,
            pixels,
            lens,
        )

    try:
        result = fitted(chosen, sigma_px)
    except PoseError as error:
        raise PoseError(f"{error}{_what_fits(fitted, chosen, sigma_px, len(marked.names), setup)}") from error
    for place in (out, report, picture):
        if place is not None:
            place.parent.mkdir(parents=True, exist_ok=True)
    write_pose(out, result, known, setup.frame)
    if report is not None:
        write_report(report, result)
    if picture is not None:
        from ltm_core.pictures import to_png
        from ltm_core.pictures.trace import residual_picture
        from ltm_core.tracing.trace_io import read_photo

        photo = read_photo(image, setup.camera) if image is not None else None
        picture.write_bytes(to_png(residual_picture(setup.camera, marked.pixels, result.residuals, result.used, photo)))
    console = Console()
    for note in held_notes(result):
        console.print(f"[yellow]{escape(note)}", highlight=False)
    if result.outliers:
        remedy = _what_fits(fitted, chosen, sigma_px, len(result.outliers), setup)
        console.print(f"[yellow]rejected as outliers: {escape(', '.join(result.outliers) + remedy)}", highlight=False)
    _print_parameters(console, result, setup.camera, setup)
    _print_points(console, result, setup, known.curvature, known.refraction)
    console.print(escape(f"  {out}"), highlight=False)


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
    import numpy as np

    from ltm_core.base.errors import PoseError

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


def _print_parameters(console: Console, result: Resection, start: Camera, setup: ResectionSetup) -> None:
    azimuth, pitch, roll = result.pose.angles_deg
    x, y, z = (float(v) for v in result.pose.position)
    values = {
        "azimuth_deg": f"{azimuth:.4f}",
        "pitch_deg": f"{pitch:.4f}",
        "roll_deg": f"{roll:.4f}",
        "fx": f"{result.camera.fx:.2f}",
        "k1": f"{result.camera.distortion[0]:.5f}",
        "k2": f"{result.camera.distortion[1]:.5f}",
        "k3": f"{result.camera.distortion[4]:.5f}",
        "cx": f"{result.camera.cx:.2f}",
        "cy": f"{result.camera.cy:.2f}",
        "x": f"{x + setup.frame.x_origin:.2f}",
        "y": f"{y + setup.frame.y_origin:.2f}",
        "z": f"{z:.2f}",
    }
    started = {"fx": f"{start.fx:.2f}", "k1": f"{start.distortion[0]:.5f}"}
    started |= {
        "x": f"{setup.position[0] + setup.frame.x_origin:.2f}",
        "y": f"{setup.position[1] + setup.frame.y_origin:.2f}",
        "z": f"{setup.position[2]:.2f}",
    }
    rows = []
    for name, value in values.items():
        sigma = result.sigmas.get(name)
        if sigma is None and name in ("k2", "k3", "cx", "cy"):
            continue
        rows.append((name, value, "held" if sigma is None else f"{sigma:.3g}", started.get(name, "")))
    print_table(console, "camera", ("parameter", ">fitted", ">sigma", ">given"), rows)


def _print_points(
    console: Console, result: Resection, setup: ResectionSetup, curvature: bool, refraction: float
) -> None:
    import numpy as np
    from rich.markup import escape

    median = float(np.median(result.residual_px))
    title = f"{len(result.used)} points: median residual {median:.2f} px"
    columns = ["point", ">u", ">v", ">du px", ">dv px", ">residual px"]
    traced = None
    below = _depth_below(setup, result)
    if below > 0:
        x, y, _ = result.pose.position
        title += (
            f"\n[yellow]the fitted camera, at ({x + setup.frame.x_origin:.1f}, {y + setup.frame.y_origin:.1f}) in "
            f"{setup.frame.crs}, is {below:.1f} m below the DEM: `ltm trace` rejects it. Check the height of the guess "
            "and the vertical datums of points and DEM"
        )
    elif setup.dem is not None:
        from ltm_core.pose_estimation.points.resection import traced_errors
        from ltm_core.tracing import TerrainTracer

        tracer = TerrainTracer(setup.dem, curvature, refraction)
        traced = traced_errors(result, tracer)
        columns += [">trace error", ">over the DEM", "state in the DEM"]
        title += f"\n{_summary(traced)}"
    rows = []
    for k, name in enumerate(result.points.names):
        u, v = result.points.pixels[k]
        du, dv = result.residuals[k]
        cells = [escape(name), f"{u:.1f}", f"{v:.1f}", f"{du:.2f}", f"{dv:.2f}", f"{result.residual_px[k]:.2f}"]
        if traced is not None:
            off, above = float(traced.errors[k]), float(traced.above_ground[k])
            cells += [f"{off:.2f} m" if traced.met[k] else "no terrain", "" if np.isnan(above) else f"{above:+.1f} m"]
            cells.append(escape(str(traced.states[k])))
        rows.append(cells if result.used[k] else [f"[red]{cell}" for cell in cells])
    print_table(console, title, columns, rows)


def _depth_below(setup: ResectionSetup, result: Resection) -> float:
    """Return how far the camera is below the DEM, in metres; NaN without a DEM."""
    x, y, z = (float(value) for value in result.pose.position)
    return float("nan") if setup.dem is None else float(setup.dem.elevation_at(x, y)) - z


def _summary(traced: TracedErrors) -> str:
    """Return the median distance between traced and surveyed places, of the points that meet terrain."""
    import numpy as np

    met, seen = traced.met, traced.met & traced.visible
    if not met.any():
        return "no marked pixel meets known terrain: check the DEM and the camera's position"
    said = f"traced against surveyed: median {np.median(traced.errors[met]):.2f} m"
    if not met.all():
        said += f" of {met.sum()} points ({(~met).sum()} meet no known terrain)"
    if seen.any():
        said += f", {np.median(traced.errors[seen]):.2f} m for the {seen.sum()} that are visible on the DEM"
    return said
