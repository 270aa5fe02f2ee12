import numpy as np
import pytest

from ltm_core.base.errors import ImageError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import DepthImage, RangeImage

CAMERA = Camera(4, 3, 5.0, 4.0, 1.0, 2.0)
POSE = Pose.from_angles((100.0, 200.0, 50.0), 90.0)  # east: x right is south, y down is down
RANGES = np.array([[np.inf, 10, 20, 30], [5, np.nan, 7, 8], [1000, 2000, 3000, 4000]], np.float32)


def test_depth_is_along_the_optical_axis() -> None:
    depth = RangeImage(RANGES, CAMERA, POSE).depth()
    assert depth.dtype == np.float32
    assert depth[0, 0] == np.inf
    assert np.isnan(depth[1, 1])
    assert depth[2, 1] == 2000.0  # the principal point
    # Pixel (u, v) = (3, 0): direction (0.4, -0.5, 1).
    assert depth[0, 3] == pytest.approx(30 / np.sqrt(1 + 0.16 + 0.25), rel=1e-6)


def test_points_by_hand() -> None:
    points = RangeImage(RANGES, CAMERA, POSE).points()
    assert points.dtype == np.float32
    np.testing.assert_allclose(points[2, 1], [2100, 200, 50])
    # Pixel (2, 2): direction (0.2, 0, 1); right is south.
    along = 3000 / np.sqrt(1.04)
    np.testing.assert_allclose(points[2, 2], [100 + along, 200 - 0.2 * along, 50], rtol=1e-6)
    # Pixel (1, 0): direction (0, -0.5, 1), upwards.
    along = 10 / np.sqrt(1.25)
    np.testing.assert_allclose(points[0, 1], [100 + along, 200, 50 + 0.5 * along], rtol=1e-6)
    assert np.isnan(points[0, 0]).all()  # sky
    assert np.isnan(points[1, 1]).all()


def test_a_bent_ray_stands_higher_over_a_falling_earth() -> None:
    bend = ray_bend(True, 0.13)
    camera = Camera(1, 1, 5.0, 5.0, 0.0, 0.0)
    pose = Pose.from_angles((0.0, 0.0, 100.0), 0.0, -5.0)
    slant = np.full((1, 1), 10_000 / np.cos(np.radians(5.0)), np.float32)  # 10 km over the ground
    point = RangeImage(slant, camera, pose, bend).points()[0, 0]
    assert point[1] == pytest.approx(10_000, abs=0.01)
    assert point[2] == pytest.approx(100 - 10_000 * np.tan(np.radians(5.0)) + 6.83, abs=0.01)


def test_horizontal_distance() -> None:
    pose = Pose.from_angles((0.0, 0.0, 0.0), 30.0, -60.0)
    ranges = RangeImage(RANGES, CAMERA, pose, 1e-6)
    horizontal = ranges.horizontal()
    assert horizontal[2, 1] == pytest.approx(1000.0)  # 2000 m at 60 degrees down
    assert horizontal[0, 0] == np.inf
    assert np.isnan(horizontal[1, 1])
    points = ranges.points()
    known = np.isfinite(RANGES)
    np.testing.assert_allclose(horizontal[known], np.hypot(points[..., 0], points[..., 1])[known], rtol=1e-5)


def test_cells() -> None:
    camera = Camera(2, 2, 1.0, 1.0, 0.0, 0.0)
    down = Pose.from_angles((0.0, 0.0, 10.0), 0.0, -90.0)  # right is east, down in the image is south
    geometry = GridGeometry(-4.0, 6.0, 8.0, 3, 2)
    slant = np.array([[10, 10 * np.sqrt(2)], [np.nan, 10 * np.sqrt(3)]], np.float32)
    # Seen: (0, 0), (10, 0), nothing, (10, -10); the grid spans -4..20 by -10..6, its southern edge is not in it.
    cells = RangeImage(slant, camera, down, geometry=geometry).cells()
    assert cells.dtype == np.int32
    assert cells[0].tolist() == [[0, 0], [0, 1]]
    assert cells[1, 0].tolist() == [-1, -1]
    moved = RangeImage(slant, camera, down, geometry=geometry.translated(0.0, -1.0)).cells()
    assert moved[1, 1].tolist() == [1, 1]
    assert RangeImage(slant, camera, down, geometry=geometry.translated(50.0, 0.0)).cells().max() == -1


def test_refused() -> None:
    with pytest.raises(ImageError, match=r"\(4, 3\) does not fit a camera of 3 x 4"):
        RangeImage(RANGES.T, CAMERA, POSE)
    with pytest.raises(ImageError, match=r"depth image of shape \(4, 3\)"):
        RangeImage.from_depth(RANGES.T, CAMERA, POSE)
    with pytest.raises(ImageError, match=r"depth image of shape \(4, 3\)"):
        DepthImage(RANGES.T, CAMERA, POSE)
    with pytest.raises(ImageError, match="no raster"):
        RangeImage(RANGES, CAMERA, POSE).cells()
