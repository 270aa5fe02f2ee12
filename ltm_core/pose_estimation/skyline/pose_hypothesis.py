"""Hold a candidate pose of a photo, and decide whether it is accepted."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, cast

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose, vector_of_matrix
from ltm_core.pose_estimation.skyline.picture_pose_config import Criteria
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between, turned
from ltm_core.pose_estimation.skyline.pose_refinement import RefinedPose

_FOCAL_STEP = 0.02


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A refined pose with its whole cost: skyline, prior and ridges. `about`: of a mean, the best fit in it."""

    refined: RefinedPose
    cost: float
    ridge_score: float
    about: Pose | None = None


def merged_with_others(hypotheses: list[Hypothesis], by_ridges: bool = False) -> list[Hypothesis]:
    """Return the hypotheses with the first pose replaced by the mean of those around it, weighted by cost, with their
    spread as uncertainty, because a smooth slope fits in many places. By ridges alone no mean fits: the first pose
    stays, and the distance of the mean adds to its uncertainty. Poses further away are alternatives."""
    if len(hypotheses) < 2:
        return hypotheses
    best, refined = hypotheses[0], hypotheses[0].refined
    changes = np.array([_change(refined, other.refined) for other in hypotheses])
    azimuths = np.array([angles_between(refined.pose, other.refined.pose)[0] for other in hypotheses])
    costs = [other.cost for other in hypotheses]
    mean, spread = mean_about_best(costs, azimuths, changes, refined.skyline.variance)
    covariance = refined.covariance + spread
    if by_ridges:
        found = replace(best, refined=replace(refined, covariance=covariance + np.outer(mean, mean)))
    else:
        found = replace(best, refined=_moved(refined, mean, covariance), about=refined.pose)
    return [found, *hypotheses[1:]]


def _moved(refined: RefinedPose, step: Float64Array, covariance: Float64Array) -> RefinedPose:
    """Return a pose moved by a step (7,) as in `_change`."""
    pose, camera = turned(refined.pose, step[3:6], step[:3]), refined.camera.zoomed(math.exp(step[6]))
    return replace(refined, pose=pose, camera=camera, covariance=covariance)


def mean_of_both(by_skyline: Hypothesis, by_ridges: Hypothesis) -> Hypothesis | None:
    """Return the first hypothesis moved between the solutions by skyline and by ridges; None if they contradict each
    other. How far their errors go together is not known: ridges take part in both, and so does the prior pose. The mean
    by half of what each knows is right whatever they share (covariance intersection: Julier and Uhlmann 1997)."""
    a, b = by_skyline.refined, by_ridges.refined
    change = _change(a, b)
    turns = slice(3, 6)
    away = float(change[turns] @ np.linalg.solve((a.covariance + b.covariance)[turns, turns], change[turns]))
    if away > Criteria.agree_chi_square:
        return None
    free = np.flatnonzero(np.diag(a.covariance) > 0)
    at = np.ix_(free, free)
    known_a, known_b = np.linalg.inv(a.covariance[at]), np.linalg.inv(b.covariance[at])
    covariance, step = np.zeros((7, 7)), np.zeros(7)
    covariance[at] = np.linalg.inv(0.5 * (known_a + known_b))
    step[free] = covariance[at] @ (0.5 * known_b @ change[free])
    return replace(by_skyline, refined=_moved(a, step, covariance))


def mean_about_best(
    costs: Sequence[float], azimuths: Float64Array, states: Float64Array, variance: float
) -> tuple[Float64Array, Float64Array]:
    """Return mean (K,) and spread (K, K) of states (N, K) whose azimuths (N,), rad, are near the first, best one."""
    near: list[int] = []
    for k in np.flatnonzero(np.abs(azimuths - azimuths[0]) <= math.radians(Criteria.alternative_deg)):
        # Starts that have ended in one place are one pose, however many they were.
        if all(abs(azimuths[j] - azimuths[k]) > math.radians(Criteria.same_deg) for j in near):
            near.append(int(k))
    weights = np.exp((costs[0] - np.array(costs)[near]) / (Criteria.agreement * variance))
    weights /= weights.sum()
    mean = weights @ states[near]
    away = states[near] - mean
    return mean, (away.T * weights) @ away


def _change(a: RefinedPose, b: RefinedPose) -> Float64Array:
    """Return (7,) from `a` to `b`: place (m), rotation about the map's axes (rad), logarithm of the focal length."""
    turn = vector_of_matrix(b.pose.rotation @ a.pose.rotation.T)
    return np.concatenate([b.pose.position - a.pose.position, turn, [math.log(b.camera.fx / a.camera.fx)]])


def search_reach(prior: PosePrior) -> float:
    """Return the range of azimuths about the prior one to search, radians: four sigmas, 12 to 40 degrees; pi if none is
    known."""
    if not prior.heading_known:
        return math.pi
    return math.radians(min(max(4.0 * prior.azimuth_sigma_deg, 12.0), 40.0))


def focal_candidates(focal_sigma: float) -> Float64Array:
    """Return the factors of the focal length to try."""
    if focal_sigma <= 0:
        return np.ones(1)
    n = math.ceil(2 * focal_sigma / _FOCAL_STEP)
    return np.asarray(np.exp(_FOCAL_STEP * np.arange(-n, n + 1)), np.float64)


MANY_PLANTS = 0.5  # share of trees and shrubs in the land above which edges belong to them as well as to the ground
OVERGROWN = 0.85  # share above which the image shows hardly anything else
Word = Literal["accepted", "ambiguous", "no_skyline", "contradicts_prior"]


@dataclass(frozen=True)
class PoseVerdict:
    """`word`, and why in words. `gap`: by how much the best alternative costs more (inf: there is none);
    `alternative_deg`: its azimuth; `sigma_deg`: of azimuth, pitch, roll; `support`: share of the skyline that fits."""

    word: Word
    reason: str
    gap: float
    alternative_deg: float | None
    sigma_deg: tuple[float, float, float]
    support: float


def judge(
    hypotheses: Sequence[Hypothesis],
    by_ridges: bool,
    prior: PosePrior,
    plants: float,
    gap_by_ridges: float | None = None,
) -> PoseVerdict:
    """Judge the first of `hypotheses`, which are in order of cost; `by_ridges`: they were found without a skyline.
    `plants`: share of plants in the image's land. `gap_by_ridges`: by which ridges alone prefer the same pose."""
    if not hypotheses:
        nowhere, reason = (math.inf, math.inf, math.inf), "the photo shows neither a skyline nor a ridge of the DEM"
        return PoseVerdict("no_skyline", reason, 0.0, None, nowhere, 0.0)
    best = hypotheses[0]
    sigma = azimuth, pitch, roll = best.refined.sigma_deg
    gap, other = math.inf, None
    middle = best.about or best.refined.pose  # what is not part of a mean is an alternative to it
    for hypothesis in hypotheses[1:]:
        away = abs(float(angles_between(middle, hypothesis.refined.pose)[0]))
        if away > math.radians(Criteria.alternative_deg):
            gap, other = hypothesis.cost - best.cost + (gap_by_ridges or 0.0), hypothesis.refined.pose.angles_deg[0]
            break
    seen = best.refined.skyline

    def verdict(reason: str, word: Word = "ambiguous") -> PoseVerdict:
        return PoseVerdict(word, reason, gap, other, sigma, seen.support)

    close, open_view = by_ridges or (plants >= OVERGROWN and gap_by_ridges is None), seen.open > Criteria.open_share
    most_azimuth = Criteria.close_azimuth_sigma_deg if close else Criteria.most_sigma_deg
    if open_view:
        most_azimuth = min(most_azimuth, Criteria.open_azimuth_sigma_deg)
    if max(sigma) > Criteria.most_sigma_deg or azimuth > most_azimuth:
        known, word = ("the ridges in the photo", "no_skyline") if by_ridges else ("the skyline", "ambiguous")
        angles = f"{azimuth:.2f}, {pitch:.2f}, {roll:.2f} deg"
        return verdict(f"{known} determines azimuth, pitch, roll only to {angles}", cast(Word, word))
    least, told = Criteria.gap_asked(seen.veiled, seen.variance), ""
    if by_ridges:
        planted = plants >= MANY_PLANTS
        least = Criteria.plants_gap if planted else Criteria.ridges_gap
        if planted and best.ridge_score < Criteria.plants_score:
            return verdict(f"the edges on ridges are only {best.ridge_score:.1f} times as strong as by chance")
        if seen.variance > Criteria.ridges_variance:
            return verdict(f"the photo's skyline contradicts it: the variance of its misfits is {seen.variance:.1f}")
    else:
        if seen.variance > Criteria.most_variance and (open_view or max(sigma) > Criteria.sharp_sigma_deg):
            doubt = "may be land beyond the DEM" if open_view else "leaves an angle uncertain"
            return verdict(f"the skyline {doubt}, and the variance of its misfits is {seen.variance:.1f}")
        if seen.veiled > 0.03:
            told = f", and plants on near crests may hide {seen.veiled:.0%} of the horizon"
    if gap < least:
        return verdict(f"azimuth {other:.1f} deg costs only {gap:.1f} more{told}")
    sure = gap_by_ridges is not None or (not open_view and max(sigma) <= Criteria.sharp_sigma_deg)
    if not by_ridges and seen.support < (Criteria.sharp_support if sure else Criteria.least_support):
        return verdict(f"only {seen.support:.0%} of the photo's skyline fits the terrain's")
    away_by = np.abs(prior.deviation(best.refined.pose)[3:]) / prior.sigmas[3:]
    if away_by.max() > Criteria.contradiction:
        name = ("azimuth", "pitch", "roll")[int(away_by.argmax())]
        return verdict(f"the photo's {name} is {away_by.max():.1f} sigmas from the stated one", "contradicts_prior")
    return verdict(f"the next best azimuth costs {gap:.1f} more" if gap < math.inf else "no alternative", "accepted")
