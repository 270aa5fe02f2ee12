"""Compile the kernels of a terrain map before the first frame needs them."""

from __future__ import annotations

import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.observation import DepthFrame, LabelImage
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.tracing import TerrainTracer


def compile_kernels(config: TerrainConfig) -> None:
    """Compile the kernels, or load them from numba's cache, so that a node that reports ready does not pause at its
    first frame. Two observations of a subsided plain exercise everything up to a change."""
    plain = Dem(np.zeros((64, 64), np.float32), GridGeometry(0.0, 64.0, 1.0, 64, 64))
    camera, pose = Camera.from_fov(64, 48, 50.0), Pose.from_angles((32.0, 5.0, 30.0), 0.0, -45.0)
    sunk = TerrainTracer(Dem(plain.elevation - 10, plain.geometry)).trace(camera, pose).depth()
    sure, seen = np.full(sunk.shape, 0.1, np.float32), np.ones(sunk.shape, np.bool_)
    covariance = np.diag([1e-4] * 3 + [1e-5] * 3)
    told, gone = LabelImage(np.ones(sunk.shape, np.uint8), camera), np.ones(256, np.float32)
    for stable in (None, seen):
        small = config.model_copy(update={"cache_mb": 32.0})
        tiny = SurfaceMap(Reference.of(plain), small, ("any",), gone=gone)
        for stamp in (0, 7_200_000_000_000):
            tiny.add(DepthFrame(sunk, sure, seen, camera, pose, stamp, "any", covariance, None, stable, told))
        tiny.decide()
