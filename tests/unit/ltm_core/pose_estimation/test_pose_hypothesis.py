"""Poses of almost the same cost beside the best: how sure it is, and what is made of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.pose_covariance import pose_covariance
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig, VerdictConfig
from ltm_core.pose_estimation.pose_hypothesis import Hypothesis, widened_by_others
from ltm_core.pose_estimation.pose_prior import PosePrior
from ltm_core.pose_estimation.pose_refinement import RefinedPose
from ltm_core.pose_estimation.pose_verdict import judge

CONFIG = VerdictConfig(alternative_deg=2.5, agreement=2.0, most_azimuth_sigma_deg=0.35)


def hypothesis(azimuth_deg: float, cost: float) -> Hypothesis:
    """Of a level camera, its angles sure to 0.1, 0.05 and 0.2 degrees, on a skyline that fits."""
    pose = Pose.from_angles((10.0, 20.0, 300.0), azimuth_deg, 0.0)
    covariance = np.zeros((7, 7))
    covariance[:6, :6] = pose_covariance(pose, 0.0, 0.0, 0.1, 0.05, 0.2)
    nothing = np.zeros((7, 7)), np.zeros(7)
    camera = Camera.from_fov(640, 360, 50.0)
    return Hypothesis(RefinedPose(pose, camera, *nothing, covariance, cost, support=0.95, veiled=0.0), cost, 1.0)


def azimuth_sigma_deg(best: Hypothesis) -> float:
    return math.degrees(math.sqrt(best.refined.covariance[5, 5]))


def test_poses_that_cost_the_same_make_the_best_one_unsure() -> None:
    others = [hypothesis(61.2, -100.0), hypothesis(60.6, -98.0), hypothesis(70.0, -99.9)]
    best, *rest = widened_by_others([hypothesis(60.0, -100.0), *others], CONFIG)
    weight = math.exp(-1.0)
    variance = 0.1**2 + (1.2**2 + weight * 0.6**2) / (2 + weight)  # the one 10 degrees off is an alternative
    assert azimuth_sigma_deg(best) == pytest.approx(math.sqrt(variance), rel=1e-4)
    assert rest == others


def test_poses_that_cost_much_more_do_not() -> None:
    best, _ = widened_by_others([hypothesis(60.0, -100.0), hypothesis(61.5, -70.0)], CONFIG)
    assert azimuth_sigma_deg(best) == pytest.approx(0.1, rel=1e-3)
    (alone,) = widened_by_others([hypothesis(60.0, -100.0)], CONFIG)
    assert azimuth_sigma_deg(alone) == pytest.approx(0.1)
    assert widened_by_others([], CONFIG) == []


@pytest.mark.parametrize(("second", "word"), [(60.3, "accepted"), (61.2, "ambiguous")])
def test_an_open_azimuth_is_not_accepted(second: float, word: str) -> None:
    found = widened_by_others([hypothesis(60.0, -100.0), hypothesis(second, -99.8)], CONFIG)
    prior = PosePrior(found[0].refined.pose, 1.5, 0.5, 0.5)
    assert judge(found, False, prior, PicturePoseConfig(verdict=CONFIG)).word == word
