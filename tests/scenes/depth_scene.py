"""A valley with two ridges, a stand of trees that its DEM does not know, a photo of it and a network's view of it."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND

CAMERA = Camera.from_fov(640, 360, 50.0)
SKY, GRASS, TREE = 0, 1, 3
STAND_HEIGHT = 10.0


@dataclass(frozen=True, eq=False)
class DepthScene:
    """`traced` over the DEM without trees, `truth` (H, W) metres with them, `labels` and `photo` of what is there."""

    dem: Dem
    traced: RangeImage
    truth: Float32Array
    labels: UInt8Array
    photo: UInt8Array

    @property
    def stand(self) -> BoolArray:
        """(H, W): pixels of trees that stand before known ground."""
        return (self.labels == TREE) & np.isfinite(self.traced.range)

    def network(self, noise: float = 0.01, seed: int = 1, scale: float = 40.0, shift: float = 0.2) -> NetworkDepth:
        """Relative inverse depth at 160 x 90: true but for scale, shift and relative noise."""
        inverse = np.where(np.isfinite(self.truth), 1.0 / self.truth, 0.0).astype(np.float32)
        small = np.asarray(cv2.resize(inverse, (160, 90), interpolation=cv2.INTER_AREA), np.float64)
        rng = np.random.default_rng(seed)
        return NetworkDepth(
            (scale * small * (1 + noise * rng.standard_normal(small.shape)) + shift).astype(np.float32),
            "relative_inverse",
        )

    def turned(self, pitch_deg: float) -> RangeImage:
        """What the tracer gives where the pose is wrong by `pitch_deg`."""
        azimuth, pitch, roll = self.traced.pose.angles_deg
        pose = Pose.from_angles(self.traced.pose.position, azimuth, pitch + pitch_deg, roll)
        return TerrainTracer(self.dem, possible=NOTHING_BEYOND).trace(CAMERA, pose)


@lru_cache(maxsize=1)
def depth_scene() -> DepthScene:
    """Made once; nobody writes into its arrays."""
    rng = np.random.default_rng(4)
    geometry = GridGeometry(-700.0, 1900.0, 5.0, 280, 400)
    rows, cols = np.mgrid[0:400, 0:280]
    x, y = geometry.to_map(rows, cols)
    rough = cv2.GaussianBlur(rng.standard_normal(x.shape), (0, 0), 6.0) * 25.0
    ridge = 55.0 * np.exp(-(((y - 620.0 - 0.25 * x) / 130.0) ** 2))
    back = 190.0 * np.exp(-(((y - 1500.0 + 0.3 * x) / 260.0) ** 2)) * (1 + 0.3 * np.sin(x / 170.0))
    bare = (ridge + back + rough).astype(np.float32)
    dem = Dem(bare, geometry)
    stand = (np.abs(x - 60.0) < 70.0) & (np.abs(y - 330.0) < 45.0)
    grown = Dem(np.where(stand, bare + np.float32(STAND_HEIGHT), bare).astype(np.float32), geometry)
    ground = float(dem.elevation_at(0.0, -40.0))
    pose = Pose.from_angles((0.0, -40.0, ground + 45.0), 3.0, -3.5)
    traced, seen = (TerrainTracer(z, possible=NOTHING_BEYOND).trace(CAMERA, pose) for z in (dem, grown))
    truth = seen.depth()
    points = seen.points()
    with np.errstate(invalid="ignore"):
        tree = np.isfinite(points[..., 0]) & (np.abs(points[..., 0] - 60.0) < 75.0)
        tree &= (np.abs(points[..., 1] - 330.0) < 50.0) & (truth < traced.depth() - 1.0)
    labels = np.where(np.isfinite(truth), np.where(tree, TREE, GRASS), SKY).astype(np.uint8)
    haze = np.where(np.isfinite(truth), 1 - np.exp(-np.where(np.isfinite(truth), truth, 0.0) / 900.0), 1.0)[..., None]
    color = np.where((labels == TREE)[..., None], (25.0, 60.0, 30.0), (150.0, 130.0, 70.0))
    color = color * (1 - haze) + np.array([190.0, 205.0, 225.0]) * haze
    photo = np.clip(color + rng.normal(0, 5, (*truth.shape, 1)), 0, 255).astype(np.uint8)
    return DepthScene(dem, traced, truth, labels, photo)
