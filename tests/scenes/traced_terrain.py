"""Real terrain that tracers are compared on; random cameras over it; what counts as equal."""

from pathlib import Path

import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from scenes.rasters import with_holes


def random_pose(dem: Dem, rng: np.random.Generator) -> Pose:
    """Mast 0.5 to 40 m above known ground, roll +-30, pitch -35 to 10."""
    while True:
        row, col = (rng.uniform(0, n - 1) for n in dem.elevation.shape)
        x, y = (float(v) for v in dem.geometry.to_map(row, col))
        ground = float(dem.elevation_at(x, y))
        mast = float(np.exp(rng.uniform(np.log(0.5), np.log(40.0))))
        if np.isfinite(ground):
            angles = rng.uniform(0, 360), rng.uniform(-35, 10), rng.uniform(-30, 30)
            return Pose.from_angles((x, y, ground + mast), *angles)


def random_camera(rng: np.random.Generator, width: int, height: int) -> Camera:
    return Camera.from_fov(width, height, float(rng.uniform(5, 90)))


def big_tujunga(data: Path) -> Dem:
    dem = Dem.open(data / "dem_bigtujunga" / "bigtujunga.tif")
    return dem.in_frame(SiteFrame(str(dem.geometry.crs), dem.geometry.x_min, dem.geometry.y_min))


def riddled(dem: Dem) -> Dem:
    """`dem` with lakes and specks without data, so many that most images see some."""
    return with_holes(dem, 6, enclosed=160, specks=1200, margin=False)


def assert_same(fast: np.ndarray, slow: np.ndarray, what: object) -> None:
    fast, slow = fast.astype(np.float64).ravel(), slow.ravel()
    wrong = np.flatnonzero((np.isnan(fast) != np.isnan(slow)) | (np.isinf(fast) != np.isinf(slow)))
    assert wrong.size == 0, f"{wrong.size} rays of {what}: {fast[wrong[0]]} against {slow[wrong[0]]}"
    hit = np.isfinite(slow)
    off = np.abs(fast[hit] - slow[hit])
    assert (off <= 1e-4 + 2 * np.spacing(slow[hit].astype(np.float32))).all(), f"off by up to {off.max()} m: {what}"
