"""`ltm pose mount`: calibrate the mount of a PTZ head, and write it into the site file."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Argument, Option

from ltm_core.base.errors import ConfigError, ImageError, PoseError
from ltm_core.geometry.zoom_lens import ZoomLens
from ltm_core.pipeline.site_surface import site_terrain
from ltm_core.pose_estimation.mount.mount_config import MountConfig, written_mount
from ltm_core.pose_estimation.mount.mount_fit import fit_mount, widened
from ltm_core.pose_estimation.mount.mount_io import read_ptz_points, read_readings
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.pose_estimation.mount.mount_resection import MountResection, resect_mount
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import find_pose
from ltm_core.pose_estimation.skyline.picture_pose_io import doubt_of_sky
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.site.networks import site_scene_filter, site_segmenter
from ltm_core.site.site import Site
from ltm_core.site.site_io import dumped, load_site, write_camera
from ltm_core.storage.disk_io import require_files
from ltm_core.tracing.trace_io import read_photo
from ltm_core.vision.masks import Looking
from ltm_ros.cli.cameras import READINGS
from ltm_ros.cli.output import Overwrite, Row, print_table, say, warn
from ltm_ros.cli.pose_points import FirstPixel, SigmaPx, parameter_names


@dataclass(frozen=True, eq=False)
class StatedMount:
    """A PTZ head as its site file describes it."""

    site: Site
    camera: str
    config: MountConfig
    model: MountModel
    lens: ZoomLens


def mount(
    site: Annotated[Path, Argument(metavar="SITE", help="Site file, in which the mount is calibrated.")],
    camera: Annotated[str, Argument(metavar="CAMERA", help="PTZ camera of the site.")],
    gcps: Annotated[
        Path | None, Option("--points", metavar="FILE", help="CSV of landmarks: id, x, y, z, u, v, pan, tilt, zoom.")
    ] = None,
    photos: Annotated[Path | None, Option(metavar="FOLDER", help="Photos of presets, with readings.csv.")] = None,
    free: Annotated[str, Option(metavar="NAMES", help="Also fit focal, lens (focal and k1), position.")] = "focal",
    first_pixel: FirstPixel = 0.0,
    sigma_px: SigmaPx = 1.0,
    out: Annotated[Path | None, Option("--out", "-o", metavar="FILE", help="File for the mount; else SITE.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate the mount of a PTZ head from landmarks or photos of several presets.

    A folder of photos needs readings.csv (name, pan_deg, tilt_deg, zoom), as `ltm cameras snapshot` writes it."""
    chosen = set(parameter_names(free))
    if chosen - {"focal", "lens", "position"}:
        raise ConfigError(f"--free {free}: landmarks fit focal, lens (focal and k1 at each zoom) and position")
    ptz = _stated_mount(site, camera)
    if out is not None:
        require_files([out], overwrite)
    elif ptz.config.calibrated and not overwrite:
        raise ConfigError(
            f"{site}: the mount of {camera} is calibrated already; replace it with --overwrite, or write to "
            "another file with --out"
        )
    if gcps is not None and photos is None:
        model, lens = _from_points(ptz, gcps, first_pixel, chosen, sigma_px)
    elif photos is not None and gcps is None:
        model, lens = _from_photos(ptz, photos), ptz.lens
    else:
        raise ConfigError("give either --points (marked landmarks) or --photos (a folder of presets)")
    section = {"mount": written_mount(model, lens if ptz.config.lens is not None else None, ptz.site.frame)}
    _print_mount(ptz.model, model)
    if out is None:
        write_camera(site, camera, section)
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(dumped(section), encoding="utf-8")
    say(f"  {out or site}")


def _stated_mount(site_file: Path, camera: str) -> StatedMount:
    """Return the PTZ head of a camera. Raises ConfigError if it has no mount or no lens."""
    site = load_site(site_file)
    settings = site.camera(camera)
    mount = settings.mount
    if mount is None:
        raise ConfigError(
            f"{site_file}: camera {camera} has no `mount:`; give its position and its approximate azimuth at pan "
            "0 (docs/cameras.md)"
        )
    if mount.lens is not None:
        lens = mount.lens.lens()
    elif settings.calibration is not None:
        lens = ZoomLens.fixed(settings.calibration.camera())
    else:
        raise ConfigError(f"{site_file}: camera {camera} has neither `mount.lens` nor `calibration`: give its lens")
    return StatedMount(site, camera, mount, mount.model(site.open_dem(), site.frame), lens)


def _from_points(
    ptz: StatedMount, gcps: Path, first_pixel: float, free: set[str], sigma_px: float
) -> tuple[MountModel, ZoomLens]:
    """Fit the mount to landmarks; print the result."""
    points = read_ptz_points(gcps, ptz.site.frame, first_pixel)
    zooms = ptz.config.lens is not None
    found = resect_mount(
        points,
        ptz.model,
        ptz.lens,
        ptz.site.bend,
        free_focal=bool({"focal", "lens"} & free) and zooms,
        free_position="position" in free,
        sigma_px=sigma_px,
        free_k1="lens" in free and zooms,
    )
    for note in found.notes:
        warn(note)
    outliers = [name for name, used in zip(points.names, found.used, strict=True) if not used]
    if outliers:
        warn(f"left out as outliers: {', '.join(outliers)}")
    _print_landmarks(found)
    return found.model, found.lens


def _from_photos(ptz: StatedMount, photos: Path) -> MountModel:
    """Fit the mount to skylines of presets, with the site's labels and mask. Raises PoseError if they are too few."""
    terrain = site_terrain(ptz.site)
    segmenter, scene = site_segmenter(ptz.site, ptz.camera), site_scene_filter(ptz.site, ptz.camera)
    azimuth, pitch, roll, tilt_zero = ptz.config.angle_sigmas_deg
    place, height = ptz.config.position_sigma or 0.0, ptz.config.height_sigma or 0.0
    priors, searches = [], []
    readings = photos / READINGS
    for name, (pan, tilt, zoom) in read_readings(readings).items():
        file = photos / name
        if not file.is_file():
            raise ConfigError(f"{readings} names {name}, which is not in {photos}")
        camera, pose = ptz.lens.camera(zoom), ptz.model.pose(pan, tilt)[0]
        photo = read_photo(file, camera)
        view = scene.look(photo, Looking.of(camera, pose))
        labels = segmenter.segment(view.scene(photo)).labels
        if (doubt := doubt_of_sky(labels, view.hidden)) is not None:
            raise ImageError(f"{file}: {doubt}")
        priors.append(PosePrior(pose, azimuth, pitch, roll, place, height))
        evidence = picture_evidence(photo, labels, camera, view.hidden)
        searches.append(find_pose(evidence, terrain, widened(priors[-1], tilt_zero)))
    fit = fit_mount(priors, searches, tilt_zero)
    if fit.word != "accepted":
        raise PoseError(
            f"these {len(priors)} photos do not determine the mount: {fit.word} ({fit.reason}). Take more presets "
            "with a clear skyline, spread in pan, or mark landmarks (--points); nothing was written"
        )
    say(f"{fit.reason}; the cost of the second best mount is {fit.gap:.1f} higher")
    return ptz.model.corrected(fit.rotation, fit.tilt_zero, fit.shift, fit.covariance)


def _print_mount(stated: MountModel, found: MountModel) -> None:
    sigmas = np.degrees(np.sqrt(np.diag(found.angle_covariance)))
    names = ("azimuth at pan 0", "pitch", "roll", "tilt zero")
    now, before = ([*m.base.angles_deg, math.degrees(m.tilt_zero)] for m in (found, stated))
    rows = [
        (name, f"{value:.3f}", f"{sigma:.3f}", f"{old:.3f}")
        for name, value, sigma, old in zip(names, now, sigmas, before, strict=True)
    ]
    for axis, words in (("pan", ("clockwise", "anticlockwise")), ("tilt", ("upwards", "downwards"))):
        sign, old_sign = (getattr(model, f"{axis}_sign") for model in (found, stated))
        rows.append((f"{axis} grows", words[sign < 0], "", words[old_sign < 0]))
    worst = max(found.direction_sigma_deg(pan) for pan in np.arange(0.0, 360.0, 10.0))
    print_table("", ("mount", ">fitted, deg", ">sigma", ">stated, deg"), rows)
    say(f"standard deviation of the viewing direction: at most {worst:.3f} deg at every pan")


def _print_landmarks(found: MountResection) -> None:
    """Print the residuals of landmarks, and the lens at each zoom if it was fitted."""
    off = np.hypot(*found.residuals.T)
    rows: list[Row] = []
    for k, name in enumerate(found.points.names):
        reading = [f"{value:.6g}" for value in found.points.readings[k]]
        du, dv = found.residuals[k]
        cells = [name, *reading, f"{du:.2f}", f"{dv:.2f}", f"{off[k]:.2f}"]
        rows.append(cells if found.used[k] else [("red", cell) for cell in cells])
    title = f"{len(off)} landmarks: median residual {np.median(off):.2f} px"
    columns = ("landmark", ">pan", ">tilt", ">zoom", ">du px", ">dv px", ">residual px")
    print_table(title, columns, rows)
    lenses = []
    for zoom, factor in found.focal_factors.items():
        lens, sigma = found.lens.camera(zoom), found.focal_sigmas[zoom]
        lenses.append(
            (f"{zoom:g}", f"{lens.hfov_deg:.3f}", f"{factor:.4f}", f"{sigma:.4f}", f"{lens.distortion[0]:.4f}")
        )
    if lenses:
        print_table("", (">zoom", ">field of view, deg", ">focal length / table", ">sigma", ">k1"), lenses)
