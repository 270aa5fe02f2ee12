import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped

from ltm_core.base.errors import PoseError
from ltm_core.geometry.pose import Pose
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose, pose_to_msg

POSE = Pose.from_angles((722.0, 671.0, 770.0), 230.77, -5.79, -0.77)


def pose_to_stamped(pose: Pose, stamp_ns: int) -> PoseStamped:
    message = pose_to_msg(pose, stamp_ns)
    return PoseStamped(header=message.header, pose=message.pose.pose)


def test_a_level_camera_that_looks_north_has_the_known_quaternion() -> None:
    """Optical x, y, z = map east, down, north: a quarter turn about x, clockwise."""
    msg = pose_to_stamped(Pose.from_angles((0, 0, 0), 0.0), 0)
    q = msg.pose.orientation
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], [-math.sqrt(0.5), 0, 0, math.sqrt(0.5)], atol=1e-15)


def test_covariance_is_carried_row_by_row() -> None:
    covariance = np.arange(36.0).reshape(6, 6)
    np.testing.assert_array_equal(pose_to_msg(POSE, 0, covariance=covariance).pose.covariance, np.arange(36.0))
    np.testing.assert_array_equal(pose_to_msg(POSE, 0).pose.covariance, np.zeros(36))


@pytest.mark.parametrize("covariance", [np.zeros((3, 3)), np.full((6, 6), np.nan)])
def test_covariance_of_another_kind_is_refused(covariance: np.ndarray) -> None:
    with pytest.raises(PoseError, match="6 x 6"):
        pose_to_msg(POSE, 0, covariance=covariance)


def test_a_quaternion_that_is_unit_within_a_thousandth_is_normalised() -> None:
    msg = pose_to_stamped(POSE, 0)
    o = msg.pose.orientation
    o.x, o.y, o.z, o.w = (v * 1.0009 for v in (o.x, o.y, o.z, o.w))
    np.testing.assert_allclose(msg_to_pose(msg).rotation, POSE.rotation, atol=1e-14)


@pytest.mark.parametrize("field", ["x", "y", "z"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_position_that_is_not_finite_is_refused(field: str, value: float) -> None:
    msg = pose_to_msg(POSE, 0)
    setattr(msg.pose.pose.position, field, value)
    with pytest.raises(PoseError, match=str(value)):
        msg_to_pose(msg)


@pytest.mark.parametrize(
    "quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.01), (math.nan, 0.0, 0.0, 1.0), (1.0, 1.0, 0.0, 0.0)]
)
def test_a_quaternion_that_is_no_rotation_is_refused(quaternion: tuple[float, ...]) -> None:
    msg = pose_to_msg(POSE, 0)
    o = msg.pose.pose.orientation
    o.x, o.y, o.z, o.w = quaternion
    with pytest.raises(PoseError, match="unit quaternion"):
        msg_to_pose(msg)


def test_a_pose_in_another_frame_is_refused() -> None:
    with pytest.raises(PoseError, match=r"'odom', expected 'map'"):
        msg_to_pose(pose_to_msg(POSE, 0, "odom"), "map")


ASSUMED = np.diag([0.25] * 3 + [1e-4] * 3)
UNKNOWN = [99_999.0, 1e6, 1e9, np.finfo(np.float64).max, np.inf]


def covariance_msg(matrix: Any) -> Any:
    msg = pose_to_msg(Pose.from_angles((1.0, 2.0, 3.0), 40.0), 5)
    msg.pose.covariance = np.asarray(matrix, np.float64).ravel()
    return msg


@pytest.mark.parametrize("word", UNKNOWN)
def test_all_words_for_unknown_are_understood(word: float) -> None:
    assert msg_to_covariance(covariance_msg(np.diag([word] * 6))) is None
    np.testing.assert_array_equal(msg_to_covariance(covariance_msg(np.diag([word] * 6)), ASSUMED), ASSUMED)
    # Position from a receiver, direction from nowhere: what is known stays.
    known = np.diag([4.0, 5.0, 6.0, word, word, word])
    assert msg_to_covariance(covariance_msg(known)) is None
    filled = msg_to_covariance(covariance_msg(known), ASSUMED)
    np.testing.assert_array_equal(filled, np.diag([4.0, 5.0, 6.0, 1e-4, 1e-4, 1e-4]))


def test_zeros_and_minus_one_say_that_nothing_is_known() -> None:
    first = np.zeros((6, 6))
    assert msg_to_covariance(covariance_msg(first)) is None
    first[0, 0] = -1.0
    assert msg_to_covariance(covariance_msg(first)) is None
    np.testing.assert_array_equal(msg_to_covariance(covariance_msg(first), ASSUMED), ASSUMED)


def spoilt(row: int, col: int, value: float) -> Any:
    matrix = np.diag([4.0, 5.0, 6.0, 0.01, 0.02, 0.03])
    matrix[row, col] = value
    return matrix


@pytest.mark.parametrize(
    "matrix",
    [
        spoilt(2, 2, np.nan),
        spoilt(0, 4, np.nan),
        spoilt(0, 4, np.inf),
        spoilt(4, 4, -0.02),
        spoilt(4, 4, -1e300),
        spoilt(0, 1, 1.0),
        spoilt(5, 0, np.finfo(np.float64).max),
        np.diag([4.0, 5.0, 6.0, 0.01, 0.02, 0.0]) + 1e-3 * (np.eye(6, k=1) + np.eye(6, k=-1)),  # with what has no error
        np.kron([[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]], np.eye(2)),  # each two may go together, not all
    ],
)
def test_what_is_no_covariance_is_refused(matrix: Any) -> None:
    with pytest.raises(PoseError, match=r"pose covariance .*(unknown|known)"):
        msg_to_covariance(covariance_msg(matrix))
