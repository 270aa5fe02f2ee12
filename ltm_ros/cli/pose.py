"""`ltm pose`: finds a camera's pose in its photo, or fits it and its calibration to ground control points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import Overwrite

if TYPE_CHECKING:
    from rich.table import Table

    from ltm_core.camera import Camera
    from ltm_core.pose_estimation.resection import Resection
    from ltm_core.pose_estimation.resection_check import TracedErrors
    from ltm_core.pose_estimation.resection_io import ResectionSetup


def pose(
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Pose file to write; `ltm trace --pose` reads it. With --poses a folder."),
    ] = None,
    pose_guess: Annotated[
        Path | None, typer.Option(help="Pose file of what is known: position, camera; angles if they are.")
    ] = None,
    photo: Annotated[
        Path | None, typer.Option(help="Photo whose skyline and ridges show its pose; with --poses a folder of them.")
    ] = None,
    gcps: Annotated[
        Path | None, typer.Option(help="CSV of control points: id, x, y, z (or lon, lat, z), u, v.")
    ] = None,
    dem: Annotated[
        list[Path] | None,
        typer.Option(help="Elevation raster, needed with --photo; again for coarser ones around it."),
    ] = None,
    poses: Annotated[Path | None, typer.Option(help="Photo list (CSV, YAML) of what is known of each photo.")] = None,
    mount: Annotated[
        bool, typer.Option("--mount", help="With --poses: one head's presets, or one camera's days: one correction.")
    ] = False,
    site: Annotated[
        Path | None,
        typer.Option(help="With --camera: calibrate the mount of a pan-tilt-zoom head; writes it into this site file."),
    ] = None,
    camera: Annotated[str, typer.Option(help="With --site: the camera on that head.")] = "",
    readings: Annotated[
        Path | None, typer.Option(help="With --site and --photo: CSV of name, pan_deg, tilt_deg, zoom of each photo.")
    ] = None,
    labels: Annotated[
        Path | None, typer.Option(help="With --photo: PNG of class ids instead of the segmentation network's.")
    ] = None,
    mask: Annotated[
        Path | None, typer.Option(help="With --photo: PNG of what never shows the landscape (`ltm mask`), not 0 there.")
    ] = None,
    model: Annotated[str, typer.Option(help="Segmentation network; default: the shipped one.")] = "",
    canopy: Annotated[
        bool, typer.Option("--canopy", help="The DEM is a surface with the tops of trees, not bare earth.")
    ] = False,
    free: Annotated[
        str | None,
        typer.Option(help="Fitted besides the angles: focal, k1, position; or none. Default: focal,k1 with --gcps."),
    ] = None,
    force: Annotated[
        str, typer.Option(help="Fitted however badly the points determine it: focal, k1, position.")
    ] = "none",
    first_pixel: Annotated[
        float, typer.Option(help="Number of the first pixel's centre in the CSV: 0 (OpenCV), 1 (Matlab), 0.5.")
    ] = 0.0,
    position_sigma: Annotated[float | None, typer.Option(help="How well the position is known, metres.")] = None,
    sigma_px: Annotated[float, typer.Option(help="What a marked pixel is worth at best, pixels.")] = 1.0,
    picture: Annotated[
        Path | None, typer.Option(help="With --photo: PNG of the terrain's lines over the photo, before and after.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="JSON with residuals, verdict and covariance.")] = None,
    crs: Annotated[str | None, typer.Option(help="CRS of the control points where no DEM states it.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Find a camera's pose: in its photo, by the terrain's skyline and ridges, or from surveyed points marked in it.

    With both, the points' pose is where the search in the photo starts. With --site and --camera, the mount of a
    pan-tilt-zoom head, from points or photos of several presets.
    """
    from ltm_core.errors import ConfigError
    from ltm_core.output_io import require_files, require_folder

    if photo is None and gcps is None:
        raise ConfigError("give --photo (a skyline in the picture), --gcps (surveyed points), or both")
    if site is not None or camera:
        if site is None or not camera:
            raise ConfigError("give --site and --camera together: which head of which site")
        _mount(
            site, camera, photo, readings, gcps, first_pixel, free or "focal", sigma_px, model, canopy, out, overwrite
        )
        return
    if out is None:
        raise ConfigError("give --out, the pose file to write")
    if poses is not None:
        require_folder(out)
        require_files([] if report is None else [report], overwrite)
    else:
        require_files([place for place in (out, report, picture) if place is not None], overwrite)
    if pose_guess is None and poses is None:
        raise ConfigError("give --pose-guess, a pose file of what is known (docs/poses.md), or --poses for many photos")
    if gcps is not None:
        assert pose_guess is not None  # nosec B101 # tells the type checker what holds
        fitted = _control_points(
            gcps, pose_guess, out, dem, free or "focal,k1", force, first_pixel, position_sigma, sigma_px, report, crs
        )
        if photo is None:
            return
        pose_guess = fitted
    assert photo is not None  # nosec B101 # tells the type checker what holds
    if not dem:
        raise ConfigError("--photo needs --dem, the elevation raster whose skyline it shows")
    _photos(
        photo, pose_guess, poses, dem, crs, labels, mask, model, free or "none", canopy, mount, out, picture, report
    )


def _mount(
    site: Path,
    camera: str,
    photo: Path | None,
    readings: Path | None,
    gcps: Path | None,
    first_pixel: float,
    free: str,
    sigma_px: float,
    model: str,
    canopy: bool,
    out: Path | None,
    overwrite: bool,
) -> None:
    from ltm_core.errors import ConfigError
    from ltm_core.output_io import require_files
    from ltm_ros.cli.pose_mount import calibrate_from_photos, calibrate_from_points, head_of, write_mount

    if photo is not None and gcps is not None:
        raise ConfigError("give either --photo or --gcps for the mount of a head, not both")
    unknown = set(_names(free)) - {"focal", "position"}
    if unknown:
        raise ConfigError(f"--free {free}: of a head, focal (the lens at each zoom) and position can be fitted")
    head = head_of(site, camera)
    if out is not None:
        require_files([out], overwrite)
    elif head.config.calibrated and not overwrite:
        raise ConfigError(
            f"{site}: the mount of {camera} is calibrated already; write over it with --overwrite, or name --out"
        )
    if gcps is not None:
        found, lens = calibrate_from_points(head, gcps, first_pixel, set(_names(free)), sigma_px)
    elif readings is None or photo is None:
        raise ConfigError("--photo with --site needs --readings, a CSV of what the encoders said of each photo")
    else:
        found, lens = calibrate_from_photos(head, photo, readings, model, canopy)
    write_mount(head, found, lens, site, camera, out)


def _photos(
    photo: Path,
    pose_guess: Path | None,
    poses: Path | None,
    dem: list[Path],
    crs: str | None,
    labels: Path | None,
    mask: Path | None,
    model: str,
    free: str,
    canopy: bool,
    mount: bool,
    out: Path,
    picture: Path | None,
    report: Path | None,
) -> None:
    from rich.console import Console
    from rich.table import Table

    from ltm_core.config_io import load_yaml
    from ltm_core.errors import ConfigError
    from ltm_core.pose_estimation.pose_file_io import GuessConfig
    from ltm_core.raster.dem_stack import open_terrain
    from ltm_ros.cli.pose_photo import PhotoOptions, guesses_of, search_photos, write_photos

    unknown = set(_names(free)) - {"focal", "position"}
    if unknown:
        raise ConfigError(f"--free {free}: a photo's skyline fits focal and position; k1 needs --gcps")
    if poses is not None:
        guesses = guesses_of(photo, poses)
    else:
        assert pose_guess is not None  # nosec B101 # tells the type checker what holds
        guesses = {photo: load_yaml(pose_guess, GuessConfig)}
    terrain = open_terrain([(dem[0], crs), *((path, None) for path in dem[1:])])
    options = PhotoOptions(labels, model, tuple(_names(free)), canopy, mount, mask)
    found = search_photos(guesses, terrain, options)
    write_photos(found, out, picture, report, poses is not None)
    table = Table("photo", "verdict", "azimuth", "pitch", "roll", "sigma, deg", "from what was given", title="poses")
    for f in found:
        angles, given = f.result.pose.angles_deg, f.setup.prior.pose.angles_deg
        moved = ((angles[0] - given[0] + 180) % 360 - 180, angles[1] - given[1], angles[2] - given[2])
        sigma = ", ".join(f"{s:.2f}" for s in f.search.verdict.sigma_deg) if f.result.accepted else "as given"
        table.add_row(f.name, f.word, *(f"{a:.3f}" for a in angles), sigma, ", ".join(f"{m:+.2f}" for m in moved))
    console = Console()
    console.print(table)
    for f in found:
        if not f.result.accepted:
            console.print(f"[yellow]{f.name}: {f.word}, the pose stays as given: {f.reason}", highlight=False)
    console.print(f"  {out}", highlight=False)


def _control_points(
    gcps: Path,
    pose_guess: Path,
    out: Path,
    dem: list[Path] | None,
    free: str,
    force: str,
    first_pixel: float,
    position_sigma: float | None,
    sigma_px: float,
    report: Path | None,
    crs: str | None,
) -> Path:
    """Fit to control points; returns the pose file that was written."""
    from typing import cast

    from rich.console import Console

    from ltm_core.config_io import load_yaml
    from ltm_core.geodesy import ray_bend
    from ltm_core.pose_estimation.pose_file_io import GuessConfig
    from ltm_core.pose_estimation.resection import resect
    from ltm_core.pose_estimation.resection_adjustment import Parameter
    from ltm_core.pose_estimation.resection_io import (
        held_notes,
        read_control_points,
        set_up_resection,
        write_pose,
        write_report,
    )
    from ltm_core.raster.dem_stack import open_terrain

    guess = load_yaml(pose_guess, GuessConfig)
    terrain = open_terrain([(dem[0], crs), *((path, None) for path in dem[1:])]) if dem else None
    setup = set_up_resection(guess, terrain, crs)
    result = resect(
        read_control_points(gcps, setup.frame, first_pixel),
        setup.camera,
        setup.position,
        setup.angles_deg,
        cast("list[Parameter]", _names(free)),
        ray_bend(guess.curvature, guess.refraction),
        position_sigma,
        sigma_px,
        cast("list[Parameter]", _names(force)),
    )
    for place in (out, report):
        if place is not None:
            place.parent.mkdir(parents=True, exist_ok=True)
    write_pose(out, result, guess, setup.frame)
    if report is not None:
        write_report(report, result, setup.frame)
    console = Console()
    for note in held_notes(result, setup.position, setup.frame):
        console.print(f"[yellow]{note}", highlight=False)
    if result.outliers:
        console.print(f"[yellow]left out as outliers: {', '.join(result.outliers)}", highlight=False)
    console.print(_parameters(result, setup.camera, setup))
    console.print(_points(result, setup, guess.curvature, guess.refraction))
    console.print(f"  {out}", highlight=False)
    return out


def _names(listed: str) -> list[str]:
    return [name.strip() for name in listed.split(",") if name.strip() not in ("", "none", "angles")]


def _parameters(result: Resection, start: Camera, setup: ResectionSetup) -> Table:
    from rich.table import Table

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
    table = Table("parameter", "fitted", "sigma", "given", title="camera")
    for name, value in values.items():
        sigma = result.sigmas.get(name)
        table.add_row(name, value, "held" if sigma is None else f"{sigma:.3g}", started.get(name, ""))
    return table


def _points(result: Resection, setup: ResectionSetup, curvature: bool, refraction: float) -> Table:
    import numpy as np
    from rich.table import Table

    median = float(np.median(result.residual_px))
    title = f"{len(result.used)} points: median residual {median:.2f} px"
    table = Table("point", "u", "v", "du px", "dv px", "residual px")
    traced = None
    if setup.dem is not None:
        from ltm_core.pose_estimation.resection_check import traced_errors
        from ltm_core.tracing import TerrainTracer

        tracer = TerrainTracer(setup.dem, curvature, refraction)
        traced = traced_errors(result, tracer)
        table.add_column("traced off by", justify="right")
        table.add_column("over the DEM", justify="right")
        table.add_column("the DEM says")
        title += f"\n{_summary(traced)}"
    for k, name in enumerate(result.points.names):
        u, v = result.points.pixels[k]
        du, dv = result.residuals[k]
        cells = [name, f"{u:.1f}", f"{v:.1f}", f"{du:.2f}", f"{dv:.2f}", f"{result.residual_px[k]:.2f}"]
        if traced is not None:
            off, above = float(traced.errors[k]), float(traced.above_ground[k])
            cells += [f"{off:.2f} m" if traced.met[k] else "no terrain", "" if np.isnan(above) else f"{above:+.1f} m"]
            cells.append(str(traced.states[k]))
        table.add_row(*cells, style=None if result.used[k] else "red")
    table.title = title
    return table


def _summary(traced: TracedErrors) -> str:
    """How far traced places lie from surveyed ones, of the points that it can be said of."""
    import numpy as np

    met, seen = traced.met, traced.met & traced.visible
    if not met.any():
        return "no marked pixel meets known terrain: check the DEM and the camera's position"
    said = f"traced against surveyed: median {np.median(traced.errors[met]):.2f} m"
    if not met.all():
        said += f" of {met.sum()} points ({(~met).sum()} meet no known terrain)"
    if seen.any():
        said += f", {np.median(traced.errors[seen]):.2f} m on the {seen.sum()} that the camera sees on the DEM"
    return said
