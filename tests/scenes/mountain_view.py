"""A camera before mountains: a DEM of hills, and pictures of it as its own tracer sees it."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND, PossibleGround
from ltm_core.vision.labels import Label

BEND = ray_bend(True, 0.13)
CAMERA = Camera.from_fov(480, 300, 52.0)
PLACE = (2100.0, 1700.0)
CRS, ORIGIN = "EPSG:32611", (380_000.0, 3_800_000.0)


@lru_cache(maxsize=1)
def mountains() -> Dem:
    """4.4 km by 3.6 km of 10 m cells: a plain about the camera, and two rings of summits."""
    geometry = GridGeometry(0.0, 3600.0, 10.0, 440, 360)
    rows, cols = np.mgrid[0:360, 0:440]
    x, y = geometry.to_map(rows, cols)
    z = np.full(x.shape, 200.0)
    rng = np.random.default_rng(5)
    for _ in range(60):
        away, at = rng.uniform(500, 1600), rng.uniform(0, 2 * np.pi)
        cx, cy = PLACE[0] + away * np.sin(at), PLACE[1] + away * np.cos(at)
        high, wide = rng.uniform(40, 200) * away / 1500, rng.uniform(60, 220)
        z += high * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * wide**2))
    return Dem(z.astype(np.float32), geometry)


def terrain() -> SearchTerrain:
    return SearchTerrain(mountains(), BEND, NOTHING_BEYOND)


def eye(height: float = 12.0) -> tuple[float, float, float]:
    return (*PLACE, float(mountains().elevation_at(*PLACE)) + height)


TRUE = Pose.from_angles(eye(), 63.0, 2.5, 1.2)
PRIOR = PosePrior(Pose.from_angles(TRUE.position, 64.4, 2.1, 0.8), 1.5, 0.5, 0.5)
"""What a mount says of it."""
OPEN = SearchTerrain(mountains(), BEND, PossibleGround())
"""The same terrain, with land beyond it that may stand over its horizon."""


def view(pose: Pose, camera: Camera = CAMERA) -> tuple[UInt8Array, UInt8Array]:
    """A photo (H, W, 3), hazier the farther the ground, and its labels (H, W): sky and bare ground."""
    ranges = TerrainTracer(mountains(), possible=NOTHING_BEYOND).trace(camera, pose).range
    sky = ~np.isfinite(ranges)
    haze = np.where(sky, 1.0, 1 - np.exp(-np.where(sky, 0.0, ranges) / 1500.0))[..., None]
    rng = np.random.default_rng(2)
    ground = np.array([70.0, 80.0, 50.0]) + 6 * rng.normal(size=(*ranges.shape, 1))
    photo = np.where(
        sky[..., None], [190.0, 210.0, 235.0], ground * (1 - haze) + haze * np.array([150.0, 165.0, 180.0])
    )
    labels = np.where(sky, np.uint8(Label.SKY), np.uint8(Label.BARE)).astype(np.uint8)
    return np.clip(photo, 0, 255).astype(np.uint8), labels


def write_site(folder: Path, **sections: Any) -> Path:
    """Write a site of this terrain, the origin of its map at ORIGIN; nothing lies beyond it."""
    dem = mountains()
    Dem(dem.elevation, dem.geometry.translated(*ORIGIN, CRS)).save(folder / "dem.tif")
    content = {"name": "ridge", "crs": CRS, "origin": list(ORIGIN), "dem": {"path": "dem.tif"}}
    content |= {"possible_ground": {"highest": -10000.0}} | sections
    (folder / "site.yaml").write_text("# The ridge.\n" + yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return folder / "site.yaml"
