"""Angles, rotations and covariances of a prior pose agree with those of `Pose`."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angle_slopes, angles_between, rotations_of, turned

azimuth = st.floats(0, 360)
tilt = st.floats(-60, 60)
sigma = st.floats(0.05, 8.0)


@settings(max_examples=40, deadline=None)
@given(azimuth, tilt, tilt)
def test_many_rotations_are_those_of_poses(a: float, p: float, r: float) -> None:
    many = rotations_of(np.array([[a, p, r], [r, p / 2, a / 4]]))
    np.testing.assert_allclose(many[0], Pose.from_angles((0, 0, 0), a, p, r).rotation, atol=1e-12)
    np.testing.assert_allclose(many[1], Pose.from_angles((0, 0, 0), r, p / 2, a / 4).rotation, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(azimuth, st.floats(-30, 30), st.floats(-20, 20), sigma, sigma, sigma)
def test_sigmas_come_back_from_their_covariance(a: float, p: float, r: float, sa: float, sp: float, sr: float) -> None:
    prior = PosePrior(Pose.from_angles((3.0, 5.0, 7.0), a, p, r), sa, sp, sr, 2.0, 3.0)
    again = PosePrior.of_covariance(prior.pose, prior.covariance)
    np.testing.assert_allclose(again.sigmas, prior.sigmas, rtol=1e-3)


@settings(max_examples=40, deadline=None)
@given(azimuth, st.floats(-40, 40), tilt, st.floats(-0.2, 0.2))
def test_a_turn_about_the_vertical_is_one_of_azimuth(a: float, p: float, r: float, by: float) -> None:
    pose = Pose.from_angles((0.0, 0.0, 0.0), a, p, r)
    np.testing.assert_allclose(angles_between(pose, turned(pose, np.array([0.0, 0.0, by]))), [-by, 0, 0], atol=1e-9)


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
