"""`ltm pose`: find a camera's pose in its photo, or fit pose and calibration to ground control points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import Overwrite, print_table

_SHARED = {"out", "overwrite"}
_OF_POINTS = {"gcps", "first_pixel", "sigma_px"}
_OF_PHOTOS = {"photo", "pose_guess", "poses", "dem", "crs", "labels", "mask", "model", "free", "canopy", "mount"}
_TAKEN = {
    "--gcps": _OF_POINTS | {"pose_guess", "dem", "crs", "free", "force", "position_sigma", "report"},
    "--photo": _OF_PHOTOS | {"picture", "report"},
    "--site with --gcps": _OF_POINTS | {"site", "camera", "free"},
    "--site with --photo": {"site", "camera", "photo", "readings", "model"},
}
"""Options that each method uses. A camera's properties come only from the site file when there is one."""


def pose(
    context: typer.Context,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Pose file to write, for `ltm trace --pose`; with --poses, a folder."),
    ] = None,
    pose_guess: Annotated[
        Path | None, typer.Option(help="Pose file with what is known: position, camera, and angles if known.")
    ] = None,
    photo: Annotated[
        Path | None, typer.Option(help="Photo with skyline and ridges; with --poses, a folder of photos.")
    ] = None,
    gcps: Annotated[
        Path | None, typer.Option(help="CSV of control points: id, x, y, z (or lon, lat, z), u, v.")
    ] = None,
    dem: Annotated[
        list[Path] | None,
        typer.Option(help="Elevation raster, required with --photo; repeat for coarser surrounding rasters."),
    ] = None,
    poses: Annotated[Path | None, typer.Option(help="Photo list (CSV, YAML) with what is known of each photo.")] = None,
    mount: Annotated[
        bool,
        typer.Option("--mount", help="With --poses: find one common correction (one PTZ head or fixed camera)."),
    ] = False,
    site: Annotated[
        Path | None,
        typer.Option(help="With --camera: calibrate a PTZ head's mount in this site file."),
    ] = None,
    camera: Annotated[str, typer.Option(help="With --site: the PTZ camera.")] = "",
    readings: Annotated[
        Path | None, typer.Option(help="With --site and --photo: CSV of name, pan_deg, tilt_deg, zoom of each photo.")
    ] = None,
    labels: Annotated[
        Path | None, typer.Option(help="With --photo: PNG of class ids, replaces the segmentation network.")
    ] = None,
    mask: Annotated[
        Path | None, typer.Option(help="With --photo: mask PNG (`ltm mask`); non-zero pixels are ignored.")
    ] = None,
    model: Annotated[str, typer.Option(help="Segmentation network. Default: the shipped one.")] = "",
    canopy: Annotated[
        bool, typer.Option("--canopy", help="The DEM includes tree tops (a surface model, not bare earth).")
    ] = False,
    free: Annotated[
        str | None,
        typer.Option(help="Also fit these: focal, k1, position; or none. Default: focal,k1 with --gcps."),
    ] = None,
    force: Annotated[str, typer.Option(help="Fit these even if poorly determined: focal, k1, position.")] = "none",
    first_pixel: Annotated[
        float, typer.Option(help="Coordinate of the first pixel's centre: 0 (OpenCV), 1 (Matlab), 0.5.")
    ] = 0.0,
    position_sigma: Annotated[float | None, typer.Option(help="Standard deviation of the position in metres.")] = None,
    sigma_px: Annotated[float, typer.Option(help="Smallest standard deviation of a marked pixel, in pixels.")] = 1.0,
    picture: Annotated[
        Path | None, typer.Option(help="With --photo: PNG of terrain lines over the photo, before and after.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="JSON with residuals, verdict and covariance.")] = None,
    crs: Annotated[str | None, typer.Option(help="CRS of the control points, if no DEM states it.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Find a camera's pose from its photo (skyline and ridges) or from surveyed points marked in it.

    With both, the search in the photo starts at the pose from the points. With --site and --camera, calibrate the mount
    of a PTZ head from points or photos of several presets.
    """
    from ltm_core.base.errors import ConfigError
    from ltm_core.storage.disk_io import require_files, require_folder
    from ltm_ros.cli.pose_points import fit_to_points

    if photo is None and gcps is None:
        raise ConfigError("give --photo (skyline in the photo), --gcps (surveyed points), or both")
    if site is not None or camera:
        if site is None or not camera:
            raise ConfigError("give --site and --camera together: the site file and its PTZ camera")
        if photo is not None and gcps is not None:
            raise ConfigError("give either --photo or --gcps for the mount of a PTZ head, not both")
        _refuse_unused(context, "--site with --gcps" if photo is None else "--site with --photo")
        _mount(site, camera, photo, readings, gcps, first_pixel, free or "focal", sigma_px, model, out, overwrite)
        return
    _refuse_unused(context, *(["--gcps"] if gcps is not None else []), *(["--photo"] if photo is not None else []))
    if out is None:
        raise ConfigError("give --out, the pose file to write")
    if poses is not None:
        require_folder(out)
        require_files([] if report is None else [report], overwrite)
    else:
        require_files([place for place in (out, report, picture) if place is not None], overwrite)
    if (pose_guess is None) == (poses is None):
        raise ConfigError("give --pose-guess, a pose file of what is known (docs/poses.md), or --poses for many photos")
    if gcps is not None and poses is not None:
        raise ConfigError("--gcps are marked in one photo: give --pose-guess, not --poses")
    if gcps is not None:
        assert pose_guess is not None  # nosec B101 # tells the type checker what holds
        fitted = fit_to_points(
            gcps,
            pose_guess,
            out,
            dem,
            _names(free or "focal,k1"),
            _names(force),
            first_pixel,
            position_sigma,
            sigma_px,
            report,
            crs,
        )
        if photo is None:
            return
        pose_guess = fitted
    assert photo is not None  # nosec B101 # tells the type checker what holds
    if not dem:
        raise ConfigError("--photo needs --dem, an elevation raster of the landscape in the photo")
    _photos(
        photo, pose_guess, poses, dem, crs, labels, mask, model, free or "none", canopy, mount, out, picture, report
    )


def _refuse_unused(context: typer.Context, *ways: str) -> None:
    """Raise ConfigError if an option was given that none of the chosen methods uses."""
    from ltm_core.base.errors import ConfigError

    taken = _SHARED.union(*(_TAKEN[way] for way in ways))
    sources = {name: context.get_parameter_source(name) for name in context.params}
    given = {name for name, source in sources.items() if source is not None and source.name == "COMMANDLINE"}
    unused = sorted(f"--{name.replace('_', '-')}" for name in given - taken)
    if unused:
        hint = "; labels, mask and terrain come from the site file" if "site" in given else ""
        raise ConfigError(f"{' and '.join(ways)} does not use {', '.join(unused)}: remove it{hint}")


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
    out: Path | None,
    overwrite: bool,
) -> None:
    from ltm_core.base.errors import ConfigError
    from ltm_core.storage.disk_io import require_files
    from ltm_ros.cli.pose_mount import calibrate_from_photos, calibrate_from_points, ptz_mount_of, write_mount

    unknown = set(_names(free)) - {"focal", "position"}
    if unknown:
        raise ConfigError(
            f"--free {free}: for a PTZ head, only focal (the lens at each zoom) and position can be fitted"
        )
    ptz = ptz_mount_of(site, camera)
    if out is not None:
        require_files([out], overwrite)
    elif ptz.config.calibrated and not overwrite:
        raise ConfigError(
            f"{site}: the mount of {camera} is calibrated already; replace it with --overwrite, or write to "
            "another file with --out"
        )
    if gcps is not None:
        found, lens = calibrate_from_points(ptz, gcps, first_pixel, set(_names(free)), sigma_px)
    elif readings is None or photo is None:
        raise ConfigError("--photo with --site needs --readings, a CSV with the encoder readings of each photo")
    else:
        found, lens = calibrate_from_photos(ptz, photo, readings, model)
    write_mount(ptz, found, lens, site, camera, out)


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

    from ltm_core.base.errors import ConfigError
    from ltm_core.raster.dem_stack import open_terrain
    from ltm_core.storage.config_io import load_yaml
    from ltm_core.tracing.trace_io import GuessConfig
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
    rows = []
    for f in found:
        angles, given = f.result.pose.angles_deg, f.setup.prior.pose.angles_deg
        moved = ((angles[0] - given[0] + 180) % 360 - 180, angles[1] - given[1], angles[2] - given[2])
        sigma = ", ".join(f"{s:.2f}" for s in f.search.verdict.sigma_deg) if f.result.accepted else "as given"
        rows.append((f.name, f.word, *(f"{a:.3f}" for a in angles), sigma, ", ".join(f"{m:+.2f}" for m in moved)))
    console = Console()
    columns = ("photo", "verdict", ">azimuth", ">pitch", ">roll", "sigma, deg", "difference from the input")
    print_table(console, "poses", columns, rows)
    for f in found:
        if not f.result.accepted:
            console.print(f"[yellow]{f.name}: {f.word}, the given pose is kept: {f.reason}", highlight=False)
    console.print(f"  {out}", highlight=False)


def _names(listed: str) -> list[str]:
    return [name.strip() for name in listed.split(",") if name.strip() not in ("", "none", "angles")]
