import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import PoseError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, matrix_of_vector, nearest_vector, pose_covariance

S = math.sqrt(0.5)
EAST, NORTH, UP = np.eye(3)


@pytest.mark.parametrize(
    ("angles", "right", "down", "forward"),
    [
        ((0, 0, 0), EAST, -UP, NORTH),
        ((90, 0, 0), -NORTH, -UP, EAST),  # azimuth: clockwise from grid north
        ((180, 0, 0), -EAST, -UP, -NORTH),
        ((270, 0, 0), NORTH, -UP, -EAST),
        ((0, 30, 0), EAST, [0, 0.5, -math.sqrt(0.75)], [0, math.sqrt(0.75), 0.5]),  # pitch: up
        ((90, -45, 0), -NORTH, [-S, 0, -S], [S, 0, -S]),
        ((0, 0, 90), -UP, -EAST, NORTH),  # roll: clockwise, so the camera's right side goes down
        ((0, 0, -90), UP, EAST, NORTH),
        ((0, 90, 0), EAST, NORTH, UP),
        ((0, -90, 0), EAST, -NORTH, -UP),  # straight down: the image's top is north
        ((90, -90, 0), -NORTH, -EAST, -UP),
    ],
)
def test_axes(angles: tuple[float, float, float], right: np.ndarray, down: np.ndarray, forward: np.ndarray) -> None:
    rotation = Pose.from_angles((0, 0, 0), *angles).rotation
    np.testing.assert_allclose(rotation.T, [right, down, forward], atol=1e-15)


def test_roll_turns_content_counter_clockwise() -> None:
    camera = Camera.from_fov(101, 101, 60.0)
    # A point right of the centre; a camera that rolls clockwise sees it move up in the image.
    point = np.array([10.0, 100.0, 0.0])
    level, rolled = (
        camera.project(Pose.from_angles((0, 0, 0), 0, 0, roll).to_optical(point)) - 50 for roll in (0.0, 20.0)
    )
    assert level[0] > 0
    assert level[1] == pytest.approx(0, abs=1e-9)
    assert math.degrees(math.atan2(-rolled[1], rolled[0])) == pytest.approx(20.0)


def test_points_between_frames() -> None:
    pose = Pose.from_angles((10.0, 20.0, 30.0), 90.0, 0.0)
    # 5 m ahead is east, 2 m right is south, 1 m down is down.
    np.testing.assert_allclose(pose.to_map(np.array([[2.0, 1.0, 5.0]])), [[15.0, 18.0, 29.0]])
    np.testing.assert_allclose(pose.to_optical(np.array([15.0, 18.0, 29.0])), [2.0, 1.0, 5.0], atol=1e-12)


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        ((40, -90, 0), (40, -90, 0)),
        ((40, -90, 25), (65, -90, 0)),  # looking down, clockwise roll turns the image's top clockwise on the map
        ((40, 90, 0), (40, 90, 0)),
        ((40, 90, 25), (15, 90, 0)),  # looking up, against it
    ],
)
def test_straight_up_and_down(angles: tuple[float, float, float], expected: tuple[float, float, float]) -> None:
    pose = Pose.from_angles((0, 0, 0), *angles)
    np.testing.assert_allclose(pose.angles_deg, expected, atol=1e-9)
    np.testing.assert_allclose(Pose.from_angles((0, 0, 0), *expected).rotation, pose.rotation, atol=1e-12)


def test_quaternion_by_hand() -> None:
    # Looking north, optical x, y, z are map x, -z, y: a turn by -90 degrees about x.
    np.testing.assert_allclose(Pose.from_angles((0, 0, 0), 0).quaternion, [-S, 0, 0, S], atol=1e-15)
    np.testing.assert_allclose(
        Pose.from_quaternion((0, 0, 0), (-S, 0, 0, S)).rotation, [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-15
    )


@pytest.mark.parametrize(
    ("position", "rotation", "message"),
    [
        ((0, float("nan"), 0), np.eye(3), "position"),
        ((0, 0), np.eye(3), "position"),
        ((0, 0, 0), np.full((3, 3), np.inf), "finite 3 x 3"),
        ((0, 0, 0), np.eye(4), "finite 3 x 3"),
        ((0, 0, 0), 1.001 * np.eye(3), "orthonormal"),
        ((0, 0, 0), np.diag([1.0, 1.0, -1.0]), "right-handed"),
    ],
)
def test_no_pose(position: tuple[float, ...], rotation: np.ndarray, message: str) -> None:
    with pytest.raises(PoseError, match=message):
        Pose(np.array(position, float), rotation)


ANGLES = (203.0, -28.0, 17.0)


@pytest.mark.parametrize("angle", range(3))
def test_each_angle_turns_about_its_axis(angle: int) -> None:
    """The rotation that a small step of an angle makes, as Pose.from_angles has it."""
    step, sigmas = 1e-5, [1e-9, 1e-9, 1e-9]
    sigmas[angle] = 2.0
    moved = list(ANGLES)
    moved[angle] += step
    pose, stepped = Pose.from_angles((1, 2, 3), *ANGLES), Pose.from_angles((1, 2, 3), *moved)
    turn = Rotation.from_matrix(stepped.rotation @ pose.rotation.T).as_rotvec() / np.radians(step)
    covariance = pose_covariance(pose, 3.0, 4.0, *sigmas)
    np.testing.assert_allclose(covariance[3:, 3:], np.radians(2.0) ** 2 * np.outer(turn, turn), atol=1e-8)
    np.testing.assert_allclose(np.diag(covariance)[:3], [9.0, 9.0, 16.0])
    assert not covariance[:3, 3:].any()


@pytest.mark.parametrize(("told", "to", "expected"), [(179.0, -179.0, -181.0), (-179.0, 540.0, 541.0), (5.0, 1.0, 5.0)])
def test_the_nearest_vector_of_the_same_rotation(told: float, to: float, expected: float) -> None:
    axis = np.array([0.6, 0.0, 0.8])
    found = nearest_vector(np.radians(told) * axis, np.radians(to) * axis)
    np.testing.assert_allclose(np.degrees(found), expected * axis)
    np.testing.assert_allclose(matrix_of_vector(found), matrix_of_vector(np.radians(told) * axis), atol=1e-12)
