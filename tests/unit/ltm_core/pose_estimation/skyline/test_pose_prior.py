"""How angles change as a pose turns."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.pose_prior import angle_slopes, angles_between, turned


@given(st.floats(0.0, 359.0), st.floats(-80.0, 80.0), st.floats(-170.0, 170.0), st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_slopes_of_angles_are_those_of_small_turns(
    azimuth: float, pitch: float, roll: float, turn: tuple[float, float, float]
) -> None:
    pose = Pose.from_angles((3.0, -4.0, 5.0), azimuth, pitch, roll)
    small = 1e-5 * np.array(turn)
    np.testing.assert_allclose(angles_between(pose, turned(pose, small)), angle_slopes(pose) @ small, atol=1e-8)


@pytest.mark.parametrize("pitch", [90.0, -90.0])
def test_straight_up_and_down_slopes_are_finite(pitch: float) -> None:
    slopes = angle_slopes(Pose.from_angles((0.0, 0.0, 0.0), 30.0, pitch, 0.0))
    assert np.isfinite(slopes).all()
    np.testing.assert_allclose(np.abs(slopes[[0, 2], 2]), 0.5)
