"""Heads that are calibrated by a few landmarks: how far off a direction is then, at worst, anywhere on the circle."""

from __future__ import annotations

import math

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.zoom_lens import LensConfig, ZoomLens, ZoomPoint
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.pose_estimation.mount.mount_resection import MountResection, resect_mount
from ltm_core.pose_estimation.points.control_points import PtzPoints
from ltm_core.visibility.point_visibility import pixel_rays

LEAN_DEG, TILT_ZERO_DEG = (0.8, 0.5), 0.3
"""Of the mount (pitch, roll) and of its tilt axis."""
ENCODER_DEG, MARK_PX = 0.03, 0.5
"""Standard deviations: of where the head comes to rest, and of a mark in a picture."""
_PLACE = np.array([100.0, -50.0, 900.0])
_TILTS = (-10.0, 0.0, 5.0)


def lens() -> ZoomLens:
    return LensConfig(width=1920, height=1080, zoom=(ZoomPoint(zoom=1, hfov_deg=62.6),)).lens()


def landmark_trial(count: int, rng: np.random.Generator, crowded_deg: float = 360.0) -> tuple[float, float]:
    """Worst error of a direction (deg), and its standard deviation as the fit states it. `count` landmarks, each in a
    picture of its own, spread over `crowded_deg` of pan. Raises PoseError where they are refused."""
    true = leaning_head(rng.uniform(0, 360))
    pans = rng.uniform(0, 360) + (np.arange(count) + rng.uniform(-0.3, 0.3, count)) * crowded_deg / count
    found = resect_mount(_marked(true, pans % 360, rng), _stated(0.0), lens(), free_focal=False)
    return worst_error_deg(found.model, true), _worst_sigma(found)


def azimuth_only(rng: np.random.Generator) -> float:
    """The same of a head of which its azimuth at pan 0 is known, and taken to stand upright."""
    azimuth = rng.uniform(0, 360)
    return worst_error_deg(_stated(azimuth), leaning_head(azimuth))


def leaning_head(azimuth_deg: float) -> MountModel:
    base = Pose.from_angles(_PLACE, azimuth_deg, *LEAN_DEG)
    return MountModel(base, math.radians(TILT_ZERO_DEG), np.zeros((7, 7)))


def worst_error_deg(found: MountModel, true: MountModel) -> float:
    """Over the circle and the tilts that such a camera looks at."""
    cosines = [
        float(found.rotation(pan, tilt)[:, 2] @ true.rotation(pan, tilt)[:, 2])
        for pan in range(0, 360, 15)
        for tilt in _TILTS
    ]
    return math.degrees(math.acos(min(1.0, min(cosines))))


def refused(count: int) -> bool:
    """Whether so few landmarks are refused."""
    try:
        landmark_trial(count, np.random.default_rng(0))
    except PoseError:
        return True
    return False


def _stated(azimuth_deg: float) -> MountModel:
    return MountModel(Pose.from_angles(_PLACE, azimuth_deg), 0.0, np.zeros((7, 7)))


def _marked(true: MountModel, pans: Float64Array, rng: np.random.Generator) -> PtzPoints:
    camera = lens().camera(1.0)
    names, places, pixels, readings = [], [], [], []
    for k, pan in enumerate(pans):
        tilt = float(rng.uniform(-8, 4))
        rotation = true.rotation(pan + ENCODER_DEG * rng.normal(), tilt + ENCODER_DEG * rng.normal())
        pixel = np.array([rng.uniform(150, 1770), rng.uniform(200, 900)])
        names.append(f"landmark{k}")
        places.append(_PLACE + rotation @ pixel_rays(camera, pixel[None])[0] * rng.uniform(800, 8000))
        pixels.append(pixel + MARK_PX * rng.normal(size=2))
        readings.append((pan, tilt, 1.0))
    return PtzPoints(tuple(names), np.array(places), np.array(pixels), np.array(readings))


def _worst_sigma(found: MountResection) -> float:
    return found.worst[1]
