"""Compile the kernels of locating before the first region needs them."""

from __future__ import annotations

import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.locating.answer import place_views
from ltm_core.locating.locator import Locator
from ltm_core.locating.region import marked_pixel
from ltm_core.locating.sighting import Sighting
from ltm_core.raster.dem import Dem
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_core.visibility.viewshed import PosedCamera


def compile_kernels() -> None:
    """Compile the kernels, or load them from numba's cache, so that the first region does not wait."""
    plain = Dem(np.zeros((60, 80), np.float32), GridGeometry(0.0, 600.0, 10.0, 80, 60))
    camera, pose = Camera.from_fov(64, 48, 50.0), Pose.from_angles((400.0, 50.0, 40.0), 0.0, -10.0)
    mark = marked_pixel(camera, (32.0, 24.0), 1.0)
    covariance = np.diag([0.1] * 3 + [1e-5] * 3)
    beside = Pose.from_angles((200.0, 50.0, 40.0), 40.0, -10.0)
    one, other = (Sighting(name, camera, at, covariance, mark) for name, at in (("one", pose), ("other", beside)))
    for smoke in (False, True):
        Locator(plain, 0.0).locate([one, other], smoke)  # of two cameras, each may be turned
    place_views(PointVisibility(plain), [PosedCamera("one", camera, pose)], np.array([400.0, 300.0, 0.0]))
