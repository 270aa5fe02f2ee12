"""Check the cameras of a site file before a run: position, view and masks."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ltm_core.base.errors import Findings, PoseError, SiteFinding, SiteVerdict
from ltm_core.base.types import Float64Array
from ltm_core.cameras.camera_config import PoseConfig
from ltm_core.cameras.plausibility import TALLEST_MAST, doubt_of_height, doubt_of_radians
from ltm_core.pose_estimation.mount.mount_config import MountConfig
from ltm_core.raster.dem import Dem
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site import Site
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.masks import Looking

_AREA = "cameras"
_MUCH_MASKED = 0.6
"""Masked share of an image above which a mask may be inverted."""
_LITTLE_LEFT = "little is left; non-zero pixels of a PNG are masked, so it may be inverted"
_TURNING = ("lens", "caption", "bar")
"""Classes of polygons that hide the same pixels in every direction of a PTZ camera."""
_WINDS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


def check_camera(found: Findings, name: str, site: Site, dem: Dem, views: list[PosedCamera]) -> None:
    """Check a camera's calibration and pose, or its mount. If both are in the site file, they are added to `views`."""
    config = site.cameras[name]
    with found.errors(_AREA, name):
        camera = config.calibration.camera() if config.calibration is not None else None
        pose = config.pose.pose(dem, site.frame) if config.pose is not None else None
        if camera is not None:
            _check_pixels(site, "calibration", camera.width, camera.height)
        if config.mount is not None:
            _check_ptz(found, config.mount, name, site, dem)
        elif pose is None or config.pose is None:
            topics = [what for what, part in (("calibration", camera), ("pose", pose)) if part is None]
            found.ok(_AREA, name, f"{' and '.join(topics)} are read from topics")
        else:
            doubt = _doubt_of_place(site, config.pose, pose.position, dem)
            azimuth, pitch, _ = pose.angles_deg
            width = "; calibration is read from a topic" if camera is None else f", {camera.hfov_deg:.0f} deg wide"
            above = pose.position[2] - dem.elevation_at(*pose.position[:2])
            said = f"{above:.1f} m above the ground, looks {_WINDS[round(azimuth / 45) % 8]} ({azimuth:g} deg), "
            said += f"{abs(pitch):g} deg {'up' if pitch > 0 else 'down'}{width}"
            found.ok(_AREA, name, said) if doubt is None else found.doubt(_AREA, name, doubt)
            if camera is not None:
                views.append(PosedCamera(name, camera, pose))


def _check_pixels(site: Site, what: str, width: int, height: int) -> None:
    if width * height > site.limits.pixels:
        raise PoseError(
            f"{what} of {width} x {height} pixels, the limit is {site.limits.pixels}: raise pixels under "
            "`expert.limits`"
        )


def _doubt_of_place(site: Site, stated: PoseConfig, position: Float64Array, dem: Dem) -> str | None:
    """Return why the position of a fixed camera may be wrong."""
    x, y, z = (float(v) for v in position)
    ground = float(dem.elevation_at(x, y))
    if math.isnan(ground):
        covered = dem.levels[-1].geometry.translated(*site.origin).described()
        return f"stands at ({stated.x:g}, {stated.y:g}) beside the DEM, which covers {covered}"
    if stated.height_above_ground is None:
        return doubt_of_height(z, ground)
    tall = f"height_above_ground {z - ground:g} m is higher than masts: if it is in feet, write metres"
    return tall if z - ground > TALLEST_MAST else None


def check_mask(found: Findings, site: Site, name: str) -> None:
    """Check a camera's mask, with its share of the image if the size is known, and the masks of its views."""
    config = site.cameras[name]
    if config.view_masks:
        with found.errors(_AREA, f"{name}: view_masks"):
            _check_view_masks(found, site, name)
    if config.mask is None:
        return
    with found.errors(_AREA, f"{name}: mask"):
        mask = site_scene_filter(site, name).mask
        said, doubts = "polygons, drawn when the calibration is read from a topic", []
        if mask is not None:
            said = f"hides {mask.mean():.1%} of {mask.shape[1]} x {mask.shape[0]} pixels"
            doubts += [_LITTLE_LEFT] if mask.mean() > _MUCH_MASKED else []
        turning = not isinstance(config.mask, Path) and all(polygon.kind in _TURNING for polygon in config.mask)
        if config.mount is not None and not turning:
            doubts.append(
                "the PTZ head turns, and the mask hides the same pixels in every view: only what turns with it belongs "
                "into it, such as corners of the lens, bars and captions; put the others into view_masks"
            )
        found.weighed(_AREA, f"{name}: mask", said, doubts)


def _check_view_masks(found: Findings, site: Site, name: str) -> None:
    config = site.cameras[name]
    lens = None if config.mount is None else config.mount.lens
    size = config.calibration or lens
    scene = site_scene_filter(site, name)
    for view in config.view_masks:
        called, width = f"{name}: mask of view {view.name}", view.hfov_deg
        looking = Looking(view.azimuth_deg, view.pitch_deg, width or 1.0)
        doubts = []
        if lens is not None and width is None:
            doubts.append("the lens zooms, but the view has no field of view: give hfov_deg, or it applies at any zoom")
        others = [other for other in config.view_masks if other is not view]
        double = [o.name for o in others if looking.off_deg(o) <= min(view.within_deg, o.within_deg)]
        if double:
            doubts.append(f"{', '.join(double)} has that direction too; the nearer one is used")
        said = f"azimuth {view.azimuth_deg:g}, pitch {view.pitch_deg:g}, within {view.within_deg:g} deg"
        with found.errors(_AREA, called):
            if size is not None:
                hidden = scene.hidden(size.width, size.height, looking)
                share = 0.0 if hidden is None else float(hidden.mean())
                said += f": hides {share:.1%} of {size.width} x {size.height} pixels"
                doubts += [_LITTLE_LEFT] if share > _MUCH_MASKED else []
            found.weighed(_AREA, called, said, doubts)


def _check_ptz(found: Findings, mount: MountConfig, name: str, site: Site, dem: Dem) -> None:
    """Check a camera on a PTZ head. Raises PoseError."""
    model = mount.model(dem, site.frame)
    if mount.lens is not None:
        _check_pixels(site, "lens", mount.lens.width, mount.lens.height)
    above = float(model.base.position[2]) - float(dem.elevation_at(*model.base.position[:2]))
    worst = max(model.direction_sigma_deg(pan) for pan in range(0, 360, 30))
    if mount.calibrated:
        found.ok(_AREA, name, f"PTZ head {above:.1f} m above the ground, directions to {worst:.2f} deg")
    else:
        calibrate = f"`ltm pose mount SITE {name}` calibrates it (docs/poses.md)"
        found.doubt(
            _AREA, name, f"its mount is not calibrated: directions are uncertain by {worst:.1f} deg; {calibrate}"
        )


def check_angles(found: Findings, site: Site, cameras: Sequence[str]) -> None:
    """Check whether the azimuths of all `cameras`, or of some, may be in radians."""
    poses = [site.cameras[name].pose for name in cameras or site.cameras]
    doubt = doubt_of_radians([pose.azimuth_deg for pose in poses if pose is not None])
    if doubt is not None:
        found.doubt(_AREA, "azimuth_deg", doubt)


def check_views(views: Sequence[PosedCamera], dem: Dem) -> Findings:
    """Check that the views of a recording are above the ground of the DEM, with a finding for each camera."""
    found = Findings()
    for name in dict.fromkeys(view.name for view in views):
        positions = np.array([view.pose.position for view in views if view.name == name])
        above = positions[:, 2] - dem.elevation_at(positions[:, 0], positions[:, 1])
        lowest = int(np.argmin(np.where(np.isnan(above), np.inf, above)))
        doubt = doubt_of_height(float(positions[lowest, 2]), float(positions[lowest, 2] - above[lowest]))
        if np.isnan(above).all():
            x, y = positions[0, :2]
            covered = dem.levels[-1].geometry.described()
            doubt = f"stands at map ({x:.0f}, {y:.0f}) beside the DEM, which covers {covered}"
        if doubt is not None:
            verdict = SiteVerdict.WRONG if above[lowest] <= 0 else SiteVerdict.DOUBTFUL
            found.append(SiteFinding.of("recording", name, doubt, verdict))
        else:
            said = f"{len(positions)} different views, {above[lowest]:.1f} m above the ground"
            found.ok("recording", name, said)
    return found
