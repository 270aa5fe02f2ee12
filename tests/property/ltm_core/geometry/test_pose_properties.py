"""What must hold for any pose."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ltm_core.geometry.pose import Pose

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


@given(poses)
def test_pitch_is_the_axis_above_the_horizon_and_a_level_camera_has_a_level_row(pose: Pose) -> None:
    azimuth, pitch, roll = np.radians(pose.angles_deg)
    right, _, forward = pose.rotation.T
    np.testing.assert_allclose(forward[2], np.sin(pitch), atol=1e-9)
    np.testing.assert_allclose(forward[:2], np.cos(pitch) * np.array([np.sin(azimuth), np.cos(azimuth)]), atol=1e-9)
    # Clockwise roll lowers the camera's right side.
    np.testing.assert_allclose(right[2], -np.sin(roll) * np.cos(pitch), atol=1e-9)


@given(poses, points)
def test_there_and_back(pose: Pose, point: tuple[float, ...]) -> None:
    optical = pose.to_optical(np.array(point))
    np.testing.assert_allclose(pose.to_map(optical), point, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(optical), np.linalg.norm(np.array(point) - pose.position), atol=1e-8)
