"""Scenes to locate in: cameras over terrain of a closed form, and marks of places on it."""

import math

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.locating.region import marked_pixel
from ltm_core.locating.sighting import Sighting
from ltm_core.raster.dem import Dem
from ltm_core.visibility.point_visibility import project

CAMERA = Camera.from_fov(1920, 1080, 54.0)


def plain(height: float = 50.0) -> Dem:
    """6 km x 4.5 km of level ground."""
    return Dem(np.full((450, 600), height, np.float32), GridGeometry(-1000.0, 4000.0, 10.0, 600, 450))


def hills() -> Dem:
    """Level ground at 0 m with two long hills that run west to east: crests of 100 m at y = 1000 and of 160 m at
    y = 2600, each 200 m wide at its foot on either side.
    """
    geometry = GridGeometry(-1505.0, 4005.0, 10.0, 302, 451)
    _, y = geometry.to_map(np.arange(geometry.height), 0)
    profile = 100 * np.clip(1 - np.abs(y - 1000) / 200, 0, 1) + 160 * np.clip(1 - np.abs(y - 2600) / 200, 0, 1)
    return Dem(np.repeat(profile[:, None], geometry.width, axis=1).astype(np.float32), geometry)


def sighting(
    name: str,
    position: tuple[float, float, float],
    place: Float64Array,
    angle_deg: float = 0.1,
    turned_deg: float = 0.0,
    bend: float = 0.0,
) -> Sighting:
    """A camera that looks towards a place (3,) and marks it exactly, with a pose that is off by `turned_deg`."""
    x, y, _ = (float(v) for v in place)
    azimuth = math.degrees(math.atan2(x - position[0], y - position[1]))
    true = Pose.from_angles(position, azimuth + 3.0, -2.0, 0.4)
    stated = Pose.from_angles(position, azimuth + 3.0 + turned_deg, -2.0, 0.4)
    covariance = pose_covariance(stated, 0.3, 0.3, angle_deg, angle_deg, angle_deg)
    pixel = project(CAMERA, true, np.asarray(place)[None], bend)[0]
    return Sighting(name, CAMERA, stated, covariance, marked_pixel(CAMERA, pixel, 2.0))
