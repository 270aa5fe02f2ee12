"""A pose that a picture may have been taken from, and where such poses are sought."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.pose_prior import PosePrior
from ltm_core.pose_estimation.pose_refinement import RefinedPose
from ltm_core.types import Float64Array

_FOCAL_STEP = 0.02


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A refined pose with its whole cost: skyline, prior and ridges."""

    refined: RefinedPose
    cost: float
    ridge_score: float


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
