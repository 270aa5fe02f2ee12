"""Check the cameras of a site file before a run: position, view and masks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ltm_core.base.errors import LtmError, PoseError, SiteFinding, SiteVerdict
from ltm_core.cameras.plausibility import TALLEST_MAST, doubt_of_height, doubt_of_radians
from ltm_core.pose_estimation.mount.mount_config import MountConfig
from ltm_core.raster.dem import Dem
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site import Site
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.masks import Looking

_MUCH_MASKED = 0.6
"""Masked share of an image above which a mask may be inverted."""
_TURNING = ("lens", "caption", "bar")
"""Classes of polygons that hide the same pixels in every direction of a PTZ camera."""
_WINDS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


def check_camera(name: str, site: Site, dem: Dem, views: list[PosedCamera]) -> Iterator[SiteFinding]:
    """Check a camera's calibration and pose, or its mount. If both are in the site file, they are added to `views`."""
    config = site.cameras[name]
    try:
        camera = config.calibration.camera() if config.calibration is not None else None
        pose = config.pose.pose(dem, site.frame) if config.pose is not None else None
        if camera is not None and camera.width * camera.height > site.limits.pixels:
            raise PoseError(
                f"calibration of {camera.width} x {camera.height} pixels, the limit is {site.limits.pixels}: "
                "raise pixels under `expert.limits`"
            )
    except LtmError as error:
        yield SiteFinding.of("cameras", name, error)
        return
    if config.mount is not None:
        yield _check_ptz(config.mount, name, site, dem)
        return
    topics = [what for what, part in (("calibration", camera), ("pose", pose)) if part is None]
    if pose is None or config.pose is None:
        yield SiteFinding("cameras", name, SiteVerdict.OK, f"{' and '.join(topics)} are read from topics")
        return
    x, y, z = (float(v) for v in pose.position)
    ground = float(dem.elevation_at(x, y))
    if math.isnan(ground):
        covered = dem.levels[-1].geometry.translated(*site.origin).described()
        doubt: str | None = f"stands at ({config.pose.x:g}, {config.pose.y:g}) beside the DEM, which covers {covered}"
    elif config.pose.height_above_ground is not None:
        tall = f"height_above_ground {z - ground:g} m is higher than masts: if it is in feet, write metres"
        doubt = tall if z - ground > TALLEST_MAST else None
    else:
        doubt = doubt_of_height(z, ground)
    azimuth, pitch, _ = pose.angles_deg
    width = "" if camera is None else f", {camera.hfov_deg:.0f} deg wide"
    found = f"{z - ground:.1f} m above the ground, looks {_WINDS[round(azimuth / 45) % 8]} ({azimuth:g} deg), "
    found += f"{abs(pitch):g} deg {'up' if pitch > 0 else 'down'}{width}"
    found += "; calibration is read from a topic" if camera is None else ""
    yield (
        SiteFinding("cameras", name, SiteVerdict.OK, found)
        if doubt is None
        else SiteFinding.of("cameras", name, doubt, SiteVerdict.DOUBTFUL)
    )
    if camera is not None:
        views.append(PosedCamera(name, camera, pose))


def check_mask(site: Site, name: str) -> Iterator[SiteFinding]:
    """Check a camera's mask, with its share of the image if the size is known, and the masks of its views."""
    config = site.cameras[name]
    yield from _check_view_masks(site, name)
    if config.mask is None:
        return
    called = f"{name}: mask"
    try:
        mask = site_scene_filter(site, name).mask
    except LtmError as error:
        yield SiteFinding.of("cameras", called, error)
        return
    found = "polygons, drawn when the calibration is read from a topic"
    doubts = []
    if mask is not None:
        found = f"hides {mask.share:.1%} of {mask.size[0]} x {mask.size[1]} pixels"
        if mask.share > _MUCH_MASKED:
            doubts.append("little is left; non-zero pixels of a PNG are masked, so it may be inverted")
    turning = not isinstance(config.mask, Path) and all(polygon.kind in _TURNING for polygon in config.mask)
    if config.mount is not None and not turning:
        doubts.append(
            "the PTZ head turns, and the mask hides the same pixels in every view: only what turns with it belongs "
            "into it, such as corners of the lens, bars and captions; put the others into view_masks"
        )
    verdict = SiteVerdict.DOUBTFUL if doubts else SiteVerdict.OK
    yield SiteFinding("cameras", called, verdict, ": ".join([found, *doubts]))


def _check_view_masks(site: Site, name: str) -> Iterator[SiteFinding]:
    config = site.cameras[name]
    if not config.view_masks:
        return
    lens = None if config.mount is None else config.mount.lens
    size = config.calibration or lens
    try:
        scene = site_scene_filter(site, name)
    except LtmError as error:
        yield SiteFinding.of("cameras", f"{name}: view_masks", error)
        return
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
        found = f"azimuth {view.azimuth_deg:g}, pitch {view.pitch_deg:g}, within {view.within_deg:g} deg"
        if size is not None:
            try:
                hidden = scene.hidden(size.width, size.height, looking)
            except LtmError as error:
                yield SiteFinding.of("cameras", called, error)
                continue
            share = 0.0 if hidden is None else float(hidden.mean())
            found += f": hides {share:.1%} of {size.width} x {size.height} pixels"
            if share > _MUCH_MASKED:
                doubts.append("little is left; non-zero pixels of a PNG are masked, so it may be inverted")
        yield SiteFinding(
            "cameras", called, SiteVerdict.DOUBTFUL if doubts else SiteVerdict.OK, "; ".join([found, *doubts])
        )


def _check_ptz(mount: MountConfig, name: str, site: Site, dem: Dem) -> SiteFinding:
    """Check a camera on a PTZ head."""
    try:
        model = mount.model(dem, site.frame)
        lens = mount.lens
        if lens is not None and lens.width * lens.height > site.limits.pixels:
            raise PoseError(
                f"lens of {lens.width} x {lens.height} pixels, the limit is {site.limits.pixels}: raise pixels "
                "under `expert.limits`"
            )
    except LtmError as error:
        return SiteFinding.of("cameras", name, error)
    above = float(model.base.position[2]) - float(dem.elevation_at(*model.base.position[:2]))
    worst = max(model.direction_sigma_deg(pan) for pan in range(0, 360, 30))
    if not mount.calibrated:
        doubt = (
            f"its mount is not calibrated: directions are uncertain by {worst:.1f} deg; `ltm pose mount SITE "
            f"{name}` calibrates it (docs/poses.md)"
        )
        return SiteFinding.of("cameras", name, doubt, SiteVerdict.DOUBTFUL)
    return SiteFinding(
        "cameras", name, SiteVerdict.OK, f"PTZ head {above:.1f} m above the ground, directions to {worst:.2f} deg"
    )


def check_angles(site: Site, cameras: Sequence[str]) -> Iterator[SiteFinding]:
    """Check whether the azimuths of all `cameras`, or of some, may be in radians."""
    poses = {name: site.cameras[name].pose for name in cameras or site.cameras}
    doubt = doubt_of_radians([pose.azimuth_deg for pose in poses.values() if pose is not None])
    if doubt is not None:
        yield SiteFinding("cameras", "azimuth_deg", SiteVerdict.DOUBTFUL, doubt)


def check_views(views: Sequence[PosedCamera], dem: Dem) -> Iterator[SiteFinding]:
    """Check that the views of a recording are above the ground of the DEM, with a finding for each camera."""
    for name in dict.fromkeys(view.name for view in views):
        positions = np.array([view.pose.position for view in views if view.name == name])
        above = positions[:, 2] - dem.elevation_at(positions[:, 0], positions[:, 1])
        lowest = int(np.argmin(np.where(np.isnan(above), np.inf, above)))
        doubt = doubt_of_height(float(positions[lowest, 2]), float(positions[lowest, 2] - above[lowest]))
        if np.isnan(above).all():
            x, y = positions[0, :2]
            doubt = (
                f"stands at map ({x:.0f}, {y:.0f}) beside the DEM, which covers {dem.levels[-1].geometry.described()}"
            )
        if doubt is not None:
            verdict = SiteVerdict.WRONG if above[lowest] <= 0 else SiteVerdict.DOUBTFUL
            yield SiteFinding.of("recording", name, doubt, verdict)
        else:
            said = f"{len(positions)} different views, {above[lowest]:.1f} m above the ground"
            yield SiteFinding("recording", name, SiteVerdict.OK, said)
