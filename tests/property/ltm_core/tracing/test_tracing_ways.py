"""The fast path against the pyramid traversal: on every pixel the same kind and the same range."""

from pathlib import Path

import numpy as np
import pytest
from scenes.rasters import rough_terrain
from scenes.traced_terrain import big_tujunga, random_camera, random_pose, riddled

from ltm_core.base.errors import PoseError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer


def assert_ways_agree(dem: Dem, seed: int, poses: int, width: int, height: int) -> None:
    rng = np.random.default_rng(seed)
    tracer = TerrainTracer(dem)
    hits = pixels = 0
    for _ in range(poses):
        camera, pose = random_camera(rng, width, height), random_pose(dem, rng)
        try:
            slow = tracer.trace(camera, pose, way="pyramid").range
        except PoseError:  # in a lake, below its rim
            continue
        hit = np.isfinite(slow)
        fast = tracer.trace(camera, pose, way="profile").range
        name = f"{camera} at {pose}"
        wrong = np.argwhere((np.isnan(fast) != np.isnan(slow)) | (np.isinf(fast) != np.isinf(slow)))
        assert len(wrong) == 0, f"{len(wrong)} pixels, first {wrong[0]} of {name}"
        off = np.abs(fast[hit] - slow[hit])
        assert (off <= 1e-4 + np.spacing(slow[hit])).all(), f"range off by up to {off.max()} m for {name}"
        hits += int(hit.sum())
        pixels += hit.size
    assert tracer.statistics.profile_bytes > 0
    assert pixels > 0.8 * poses * width * height
    assert hits > 0.2 * pixels


def test_every_pixel_of_real_mountains(shared_data: Path) -> None:
    assert_ways_agree(big_tujunga(shared_data), 13, poses=6, width=161, height=121)


@pytest.mark.slow
@pytest.mark.parametrize("holes", [False, True])
def test_every_pixel_of_sixty_poses_in_real_mountains(shared_data: Path, holes: bool) -> None:
    dem = big_tujunga(shared_data)
    assert_ways_agree(riddled(dem) if holes else dem, 14, poses=60, width=320, height=240)


def test_on_node_lines_and_at_the_rim() -> None:
    """Positions on nodes and on the raster's outermost node lines, cameras along the axes and straight down."""
    dem = rough_terrain(8)
    tracer = TerrainTracer(dem)
    rows, cols = dem.elevation.shape
    for row, col in [(0, 0), (rows - 1, cols - 1), (0, 77.0), (55.0, cols - 1), (90.0, 130.0), (90.5, 131.0)]:
        x, y = (float(v) for v in dem.geometry.to_map(row, col))
        for azimuth in (0.0, 90.0, 225.0):
            for pitch in (-10.0, -90.0, 30.0):
                pose = Pose.from_angles((x, y, float(dem.elevation_at(x, y)) + 6.0), azimuth, pitch, 0.0)
                camera = Camera(81, 61, 50.0, 50.0, 40.0, 30.0)
                slow = tracer.trace(camera, pose, way="pyramid").range
                # Which side of the rim a ray along it is on, is a matter of the 19th digit.
                east, north, _ = np.abs(np.moveaxis(camera.rays() @ pose.rotation.T, -1, 0))
                clear = np.minimum(east, north) > 1e-15
                assert clear.mean() > 0.95
                fast = tracer.trace(camera, pose, way="profile").range
                message = f"{row} {col} {azimuth} {pitch}"
                np.testing.assert_allclose(fast[clear], slow[clear], rtol=1e-6, err_msg=message)
