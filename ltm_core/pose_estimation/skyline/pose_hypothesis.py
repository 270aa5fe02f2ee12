"""Hold the prior of a pose, and a pose that a photo may have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.pose_covariance import UNKNOWN_AZIMUTH_SIGMA_DEG, axes_of_angles, pose_covariance
from ltm_core.geometry.rotations import matrix_of_vector, vector_of_matrix
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig, VerdictConfig
from ltm_core.pose_estimation.skyline.pose_refinement import RefinedPose

UNKNOWN_DEG = UNKNOWN_AZIMUTH_SIGMA_DEG
"""Sigma of an azimuth of which nothing is known."""


@dataclass(frozen=True, eq=False)
class PosePrior:
    """A pose with independent standard deviations: degrees of azimuth, pitch and roll, metres of x and y, and of z.

    An azimuth sigma of UNKNOWN_DEG or more says that the heading is unknown. A position sigma of 0 holds the position.
    Raises PoseError for sigmas that are none.
    """

    pose: Pose
    azimuth_sigma_deg: float = 1.5
    pitch_sigma_deg: float = 0.5
    roll_sigma_deg: float = 0.5
    position_sigma: float = 0.0
    height_sigma: float = 0.0

    def __post_init__(self) -> None:
        angles = (self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg)
        if not all(math.isfinite(s) and s > 0 for s in angles):
            raise PoseError(f"sigmas of azimuth, pitch and roll must be positive degrees, got {angles}")
        places = (self.position_sigma, self.height_sigma)
        if not all(math.isfinite(s) and s >= 0 for s in places):
            raise PoseError(f"sigmas of position and height must be metres, 0 or more, got {places}")

    @classmethod
    def of_covariance(cls, pose: Pose, covariance: Float64Array) -> PosePrior:
        """From a (6, 6) covariance as in `pose_covariance`; raises PoseError where its angles have none."""
        slopes = angle_slopes(pose)
        angles = np.degrees(np.sqrt(np.maximum(np.diag(slopes @ covariance[3:, 3:] @ slopes.T), 0.0)))
        place = np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0))
        azimuth, pitch, roll = (float(a) for a in angles)
        return cls(pose, azimuth, pitch, roll, float(max(place[0], place[1])), float(place[2]))

    @property
    def heading_known(self) -> bool:
        return self.azimuth_sigma_deg < 0.99 * UNKNOWN_DEG  # it may have come through a covariance

    @property
    def sigmas(self) -> Float64Array:
        """(6,): x, y, z (m), azimuth, pitch, roll (rad)."""
        angles = np.radians([self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg])
        return np.array([self.position_sigma, self.position_sigma, self.height_sigma, *angles])

    @property
    def covariance(self) -> Float64Array:
        """(6, 6) as in `pose_covariance`."""
        angles = (self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg)
        return pose_covariance(self.pose, self.position_sigma, self.height_sigma, *angles)

    def deviation(self, pose: Pose) -> Float64Array:
        """(6,) of a pose from this one: x, y, z (m), azimuth, pitch, roll (rad)."""
        return np.concatenate([pose.position - self.pose.position, angles_between(self.pose, pose)])


def angles_between(a: Pose, b: Pose) -> Float64Array:
    """Azimuth, pitch and roll (3,), radians in [-pi, pi), by which `b` differs from `a`."""
    change = np.radians(np.subtract(b.angles_deg, a.angles_deg))
    return np.asarray((change + math.pi) % (2 * math.pi) - math.pi, np.float64)


def angle_slopes(pose: Pose) -> Float64Array:
    """(3, 3): azimuth, pitch and roll (rad) by rotations about the map's x, y and z (rad). Straight up or down, where
    azimuth and roll turn about one axis, each takes half of a turn about it."""
    return np.asarray(np.linalg.pinv(axes_of_angles(pose)), np.float64)


def rotations_of(angles_deg: Float64Array) -> Float64Array:
    """(P, 3, 3), optical to map, of azimuth, pitch and roll (P, 3), as `Pose.from_angles` has them."""
    a, p, r = np.radians(angles_deg).T
    zero = np.zeros_like(a)
    forward = np.stack([np.sin(a) * np.cos(p), np.cos(a) * np.cos(p), np.sin(p)], axis=-1)
    level_right = np.stack([np.cos(a), -np.sin(a), zero], axis=-1)
    level_down = np.cross(forward, level_right)
    c, s = np.cos(r)[:, None], np.sin(r)[:, None]
    return np.stack([c * level_right + s * level_down, c * level_down - s * level_right, forward], axis=-1)


def turned(pose: Pose, rotation: Float64Array, shift: Float64Array | None = None) -> Pose:
    """A pose turned by a rotation vector (3,) about the map's axes, and shifted."""
    matrix = matrix_of_vector(rotation) @ pose.rotation
    u, _, vt = np.linalg.svd(matrix)  # many small turns stay a rotation
    return Pose(pose.position if shift is None else pose.position + shift, u @ vt)


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
