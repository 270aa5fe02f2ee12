"""`ltm pose --gcps`: fit a camera's pose and calibration to ground control points, and print the residuals."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ltm_ros.cli.output import print_table

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_core.geometry.camera import Camera
    from ltm_core.pose_estimation.points.resection import Resection, TracedErrors
    from ltm_core.pose_estimation.points.resection_io import ResectionSetup


def fit_to_points(
    gcps: Path,
    pose_guess: Path,
    out: Path,
    dem: list[Path] | None,
    free: list[str],
    force: list[str],
    first_pixel: float,
    position_sigma: float | None,
    sigma_px: float,
    report: Path | None,
    crs: str | None,
) -> Path:
    """Fit to control points; return the written pose file."""
    from typing import cast

    from rich.console import Console
    from rich.markup import escape

    from ltm_core.geometry.geodesy import ray_bend
    from ltm_core.pose_estimation.points.resection import resect
    from ltm_core.pose_estimation.points.resection_adjustment import Parameter
    from ltm_core.pose_estimation.points.resection_io import (
        held_notes,
        read_control_points,
        set_up_resection,
        write_pose,
        write_report,
    )
    from ltm_core.raster.dem_stack import open_terrain
    from ltm_core.storage.config_io import load_yaml
    from ltm_core.tracing.trace_io import GuessConfig

    guess = load_yaml(pose_guess, GuessConfig)
    terrain = open_terrain([(dem[0], crs), *((path, None) for path in dem[1:])]) if dem else None
    setup = set_up_resection(guess, terrain, crs)
    result = resect(
        read_control_points(gcps, setup.frame, first_pixel),
        setup.camera,
        setup.position,
        setup.angles_deg,
        cast("list[Parameter]", free),
        ray_bend(guess.curvature, guess.refraction),
        position_sigma,
        sigma_px,
        cast("list[Parameter]", force),
    )
    for place in (out, report):
        if place is not None:
            place.parent.mkdir(parents=True, exist_ok=True)
    write_pose(out, result, guess, setup.frame)
    if report is not None:
        write_report(report, result, setup.frame)
    console = Console()
    for note in held_notes(result, setup.position, setup.frame):
        console.print(f"[yellow]{escape(note)}", highlight=False)
    if result.outliers:
        console.print(f"[yellow]left out as outliers: {escape(', '.join(result.outliers))}", highlight=False)
    _print_parameters(console, result, setup.camera, setup)
    _print_points(console, result, setup, guess.curvature, guess.refraction)
    console.print(escape(f"  {out}"), highlight=False)
    return out


def _print_parameters(console: Console, result: Resection, start: Camera, setup: ResectionSetup) -> None:
    azimuth, pitch, roll = result.pose.angles_deg
    x, y, z = (float(v) for v in result.pose.position)
    values = {
        "azimuth_deg": f"{azimuth:.4f}",
        "pitch_deg": f"{pitch:.4f}",
        "roll_deg": f"{roll:.4f}",
        "fx": f"{result.camera.fx:.2f}",
        "k1": f"{result.camera.distortion[0]:.5f}",
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
    if setup.dem is not None:
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
