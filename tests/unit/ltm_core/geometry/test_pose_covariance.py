"""Covariance of a pose from sigmas of its place and angles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ltm_core.geometry.pose import Pose, pose_covariance

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
