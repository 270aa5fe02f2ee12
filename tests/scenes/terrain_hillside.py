"""A small hillside with a patch that is raised or lowered, and what two exact cameras measure of it."""

from dataclasses import replace

import numpy as np

from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.observation import DepthFrame
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND

GEOMETRY = GridGeometry(0.0, 230.0, 1.0, 300, 230)
CAMERA = Camera.from_fov(320, 180, 55.0)
PLACES = {"west": (90.0, 20.0, 20.0), "east": (210.0, 20.0, -20.0)}
"""x, y, azimuth."""
HOUR = 3_600_000_000_000
BEGIN = 1_700_000_000_000_000_000
RULES = TerrainConfig(register_frames=False, threshold=1.0)
SURE = np.diag([1e-6] * 3 + [1e-12] * 3)


def hillside() -> Float64Array:
    row, col = np.mgrid[0:230, 0:300]
    y = 229.5 - row
    rolling = 2.0 * np.sin(col / 31.0) + 1.5 * np.cos(row / 23.0)
    return np.asarray(400.0 + 0.45 * np.maximum(y - 60.0, 0.0) + rolling)


def dem(heights: Float64Array) -> Dem:
    return Dem(heights.astype(np.float32), GEOMETRY)


BARE = hillside()
PATCH = np.zeros(BARE.shape, bool)
PATCH[70:100, 130:170] = True


def surface_map(
    given: Float64Array | None = None, rules: TerrainConfig = RULES, store: TileStore | None = None
) -> SurfaceMap:
    reference = Reference.of(dem(BARE), None if given is None else dem(given))
    return SurfaceMap(reference, rules, tuple(PLACES), store)


def frame(
    heights: Float64Array, source: str = "west", hours: float = 0.0, noise: float = 0.3, **changes: object
) -> DepthFrame:
    """What a camera measures of a surface, with sigma `noise` metres."""
    x, y, azimuth = PLACES[source]
    pose = Pose.from_angles((x, y, float(dem(BARE).elevation_at(x, y)) + 25.0), azimuth, -2.0)
    rng = np.random.default_rng(round(hours * 100) + len(source))
    depth = TerrainTracer(dem(heights), possible=NOTHING_BEYOND).trace(CAMERA, pose).depth()
    depth = (depth + noise * rng.standard_normal(depth.shape)).astype(np.float32)
    whole = DepthFrame(
        depth,
        np.full(depth.shape, noise, np.float32),
        np.ones(depth.shape, bool),
        CAMERA,
        pose,
        BEGIN + round(hours * HOUR),
        source,
        SURE,
    )
    return replace(whole, **changes)


def changed_share(surface: SurfaceMap, where: BoolArray = PATCH) -> float:
    """Of the cells of a patch that independent views have seen."""
    layers = surface.layers()
    return float((layers.change[where & layers.observed] > 0).mean())


RAISED, LOWERED = BARE + 6.0 * PATCH, BARE - 4.0 * PATCH
