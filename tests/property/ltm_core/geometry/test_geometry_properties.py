"""What must hold for any camera, pose and grid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes.examples import examples

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose

pytestmark = pytest.mark.kernel

coefficients = st.tuples(
    st.floats(-0.4, 0.4), st.floats(-0.2, 0.2), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.floats(-0.1, 0.1)
)
cameras = st.builds(
    Camera,
    st.integers(2, 40),
    st.integers(2, 30),
    st.floats(15, 200),
    st.floats(15, 200),
    st.floats(-5, 45),
    st.floats(-5, 35),
    coefficients,
)


@examples(60, in_fuzz=150)
@given(cameras)
def test_every_ray_projects_to_its_pixel(camera: Camera) -> None:
    rays = camera.rays()
    known = np.isfinite(rays).all(axis=-1)
    np.testing.assert_array_equal(known, np.isfinite(rays).any(axis=-1))
    np.testing.assert_allclose(np.linalg.norm(rays[known], axis=-1), 1.0, rtol=1e-12)
    v, u = np.indices(known.shape)
    np.testing.assert_allclose(camera.project(rays[known]), np.stack([u, v], axis=-1)[known], atol=1e-5)


@examples(40, in_fuzz=60)
@given(cameras, st.integers(1, 12))
def test_a_sampled_image_has_the_rays_of_its_pixels(camera: Camera, step: int) -> None:
    rays = camera.rays()[::step, ::step]
    sampled = camera.scaled(step).rays()
    assert sampled.shape == rays.shape
    both = np.isfinite(rays) & np.isfinite(sampled)
    assert both.sum() >= np.isfinite(rays).sum() - 3  # rounding may decide for a pixel right on the fold
    np.testing.assert_allclose(sampled[both], rays[both], atol=1e-6)


positions = st.tuples(*[st.floats(-1e5, 1e5)] * 3)
poses = st.builds(Pose.from_angles, positions, st.floats(-720, 720), st.floats(-90, 90), st.floats(-180, 180))
points = st.tuples(*[st.floats(-1e4, 1e4)] * 3)


@given(positions, st.floats(0, 359.999), st.floats(-89.9, 89.9), st.floats(-179.9, 179.9))
def test_angles_come_back(position: tuple[float, ...], azimuth: float, pitch: float, roll: float) -> None:
    back = Pose.from_angles(position, azimuth, pitch, roll).angles_deg
    assert 0 <= back[0] < 360
    assert abs((back[0] - azimuth + 180) % 360 - 180) < 1e-6
    np.testing.assert_allclose(back[1:], (pitch, roll), atol=1e-6)


@given(poses)
def test_angles_and_quaternion_say_the_same_as_the_rotation(pose: Pose) -> None:
    np.testing.assert_allclose(Pose.from_angles(pose.position, *pose.angles_deg).rotation, pose.rotation, atol=1e-9)
    np.testing.assert_allclose(Pose.from_quaternion(pose.position, pose.quaternion).rotation, pose.rotation, atol=1e-12)
    assert pose.quaternion[3] >= 0


@given(poses, points)
def test_there_and_back(pose: Pose, point: tuple[float, ...]) -> None:
    optical = pose.to_optical(np.array(point))
    np.testing.assert_allclose(pose.to_map(optical), point, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(optical), np.linalg.norm(np.array(point) - pose.position), atol=1e-8)


# Eighths of a metre are exact in float64, so that edges are hit and not only approached.
metres = st.integers(-80_000, 80_000).map(lambda n: n / 8)
resolutions = st.sampled_from([0.5, 1.0, 2.0, 7.0, 30.0, 33.0])
grids = st.builds(GridGeometry, metres, metres, resolutions, st.integers(1, 50), st.integers(1, 40))


@given(grids, metres, metres)
def test_a_point_lies_in_its_cell_and_in_no_other(grid: GridGeometry, x: float, y: float) -> None:
    row, col = (int(v) for v in grid.cell_of(x, y))
    west, north = grid.x_min + col * grid.resolution, grid.y_max - row * grid.resolution
    assert west <= x < west + grid.resolution
    assert north - grid.resolution < y <= north
    assert bool(grid.contains(row, col)) == (grid.x_min <= x < grid.x_max and grid.y_min < y <= grid.y_max)


@given(grids, st.integers(-9, 60), st.integers(-9, 60))
def test_the_centre_of_a_cell_is_in_it(grid: GridGeometry, row: int, col: int) -> None:
    assert [int(v) for v in grid.cell_of(*grid.to_map(row, col))] == [row, col]
    window = grid.window(row, col, 3, 2)
    np.testing.assert_array_equal(window.to_map(0, 0), grid.to_map(row, col))


@given(metres, metres, st.floats(0, 500), st.floats(0, 500), resolutions, st.sampled_from([0.0, 15.0, -4.5]))
def test_snapped_is_the_smallest_cover(
    x: float, y: float, width: float, height: float, resolution: float, phase: float
) -> None:
    grid = GridGeometry.snapped((x, y, x + width, y + height), resolution, phase)
    x_min, y_min, x_max, y_max = grid.bounds
    assert x_min <= x
    assert y_min <= y
    assert x_max >= x + width
    assert y_max >= y + height
    assert x - x_min < resolution
    assert y - y_min < resolution or grid.height == 1  # bounds of no height may lie on an edge
    assert x_max - (x + width) < resolution or grid.width == 1
    assert y_max - (y + height) < resolution or grid.height == 1
    for edge in grid.bounds:
        assert ((edge - phase) / resolution).is_integer()
