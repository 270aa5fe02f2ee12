"""A pose that a picture may have been taken from, and where such poses are sought."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.pose import Pose
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig, VerdictConfig
from ltm_core.pose_estimation.pose_prior import PosePrior, angles_between, turned
from ltm_core.pose_estimation.pose_refinement import RefinedPose
from ltm_core.rotations import vector_of_matrix
from ltm_core.types import Float64Array

_FOCAL_STEP = 0.02


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A refined pose with its whole cost: skyline, prior and ridges. `about`: where it is a mean, the best fit of those
    that it is the mean of."""

    refined: RefinedPose
    cost: float
    ridge_score: float
    about: Pose | None = None


def merged_with_others(hypotheses: list[Hypothesis], config: VerdictConfig) -> list[Hypothesis]:
    """The same, from the best down, the first one's pose the mean of those about it, each with its weight by cost, and
    as uncertain as they are spread: a smooth slope fits in many places. Those further away are alternatives
    (`pose_verdict`).
    """
    if len(hypotheses) < 2:
        return hypotheses
    best, refined = hypotheses[0], hypotheses[0].refined
    mean, spread = _about_best(hypotheses, config)
    merged = replace(
        refined,
        pose=turned(refined.pose, mean[3:6], mean[:3]),
        camera=refined.camera.zoomed(math.exp(mean[6])),
        covariance=refined.covariance + spread,
    )
    return [replace(best, refined=merged, about=refined.pose), *hypotheses[1:]]


def widened_by_others(hypotheses: list[Hypothesis], config: VerdictConfig) -> list[Hypothesis]:
    """The same, the first one where it is, and as uncertain as those about it lie away from it: of poses by ridges
    alone one is on its edges, and a mean on none.
    """
    if len(hypotheses) < 2:
        return hypotheses
    best = hypotheses[0]
    mean, spread = _about_best(hypotheses, config)
    wider = replace(best.refined, covariance=best.refined.covariance + spread + np.outer(mean, mean))
    return [replace(best, refined=wider), *hypotheses[1:]]


def mean_of_both(by_skyline: Hypothesis, by_ridges: Hypothesis, config: VerdictConfig) -> Hypothesis | None:
    """The first one, between where skyline and ridges alone put it; None where they contradict each other.

    How far their errors go together is not known: ridges take part in both, and so does the prior pose. The mean by
    half of what each knows is right whatever they share (covariance intersection: Julier and Uhlmann 1997), and no
    surer than the surer one.
    """
    a, b = by_skyline.refined, by_ridges.refined
    change = _change(a, b)
    turns = slice(3, 6)
    away = float(change[turns] @ np.linalg.solve((a.covariance + b.covariance)[turns, turns], change[turns]))
    if away > config.agree_chi_square:
        return None
    free = np.flatnonzero(np.diag(a.covariance) > 0)
    at = np.ix_(free, free)
    known_a, known_b = np.linalg.inv(a.covariance[at]), np.linalg.inv(b.covariance[at])
    covariance, step = np.zeros((7, 7)), np.zeros(7)
    covariance[at] = np.linalg.inv(0.5 * (known_a + known_b))
    step[free] = covariance[at] @ (0.5 * known_b @ change[free])
    camera = a.camera.zoomed(math.exp(step[6]))
    mean = replace(a, pose=turned(a.pose, step[turns], step[:3]), camera=camera, covariance=covariance)
    return replace(by_skyline, refined=mean)


def _about_best(hypotheses: list[Hypothesis], config: VerdictConfig) -> tuple[Float64Array, Float64Array]:
    """Of those about the first, how far their mean is from it (7,), as in `_change`, and their spread about that."""
    best = hypotheses[0].refined
    changes = np.array([_change(best, other.refined) for other in hypotheses])
    azimuths = np.array([angles_between(best.pose, other.refined.pose)[0] for other in hypotheses])
    return mean_about_best([other.cost for other in hypotheses], azimuths, changes, best.skyline.variance, config)


def mean_about_best(
    costs: Sequence[float], azimuths: Float64Array, states: Float64Array, variance: float, config: VerdictConfig
) -> tuple[Float64Array, Float64Array]:
    """Mean (K,) of states (N, K) and their spread about it (K, K), of those whose azimuths (N,), rad, are near that of
    the first, the best. `variance`: of the skyline's misfits."""
    near: list[int] = []
    for k in np.flatnonzero(np.abs(azimuths - azimuths[0]) <= math.radians(config.alternative_deg)):
        # Starts that have ended in one place are one pose, however many they were.
        if all(abs(azimuths[j] - azimuths[k]) > math.radians(config.same_deg) for j in near):
            near.append(int(k))
    weights = np.exp((costs[0] - np.array(costs)[near]) / (config.agreement * variance))
    weights /= weights.sum()
    mean = weights @ states[near]
    away = states[near] - mean
    return mean, (away.T * weights) @ away


def _change(a: RefinedPose, b: RefinedPose) -> Float64Array:
    """(7,) from `a` to `b`: place (m), rotation about the map's axes (rad), logarithm of the focal length."""
    turn = vector_of_matrix(b.pose.rotation @ a.pose.rotation.T)
    return np.concatenate([b.pose.position - a.pose.position, turn, [math.log(b.camera.fx / a.camera.fx)]])


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
