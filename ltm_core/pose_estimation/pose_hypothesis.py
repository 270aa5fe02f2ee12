"""A pose that a picture may have been taken from, and where such poses are sought."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig, VerdictConfig
from ltm_core.pose_estimation.pose_prior import PosePrior, angles_between
from ltm_core.pose_estimation.pose_refinement import RefinedPose
from ltm_core.types import Float64Array

_FOCAL_STEP = 0.02


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A refined pose with its whole cost: skyline, prior and ridges."""

    refined: RefinedPose
    cost: float
    ridge_score: float


def widened_by_others(hypotheses: list[Hypothesis], config: VerdictConfig) -> list[Hypothesis]:
    """The same, from the best down, the first one's angles as uncertain as the others about it say that cost hardly
    more: a smooth slope fits in many places. Those that are further away are alternatives (`pose_verdict`)."""
    if len(hypotheses) < 2:
        return hypotheses
    best = hypotheses[0]
    near = [
        other
        for other in hypotheses
        if abs(angles_between(best.refined.pose, other.refined.pose)[0]) <= math.radians(config.alternative_deg)
    ]
    weights = np.exp([(best.cost - other.cost) / config.agreement for other in near])
    turns = np.array([other.refined.pose.rotation @ best.refined.pose.rotation.T for other in near])
    away = Rotation.from_matrix(turns).as_rotvec()
    covariance = best.refined.covariance.copy()
    covariance[3:6, 3:6] += (away.T * weights) @ away / weights.sum()
    return [replace(best, refined=replace(best.refined, covariance=covariance)), *hypotheses[1:]]


def search_reach(prior: PosePrior, config: PicturePoseConfig) -> float:
    """Radians of azimuth about the prior one within which poses are sought; pi where none is known."""
    s = config.search
    if not prior.heading_known:
        return math.pi
    return math.radians(min(max(s.reach_sigmas * prior.azimuth_sigma_deg, s.least_reach_deg), s.most_reach_deg))


def focal_candidates(focal_sigma: float) -> Float64Array:
    """Factors of the focal length that are tried."""
    if focal_sigma <= 0:
        return np.ones(1)
    n = math.ceil(2 * focal_sigma / _FOCAL_STEP)
    return np.asarray(np.exp(_FOCAL_STEP * np.arange(-n, n + 1)), np.float64)
