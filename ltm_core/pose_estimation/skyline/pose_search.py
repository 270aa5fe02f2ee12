"""Search poses by the skyline, and by ridges alone."""

import math
from dataclasses import replace

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, matrix_of_angles, pose_covariance
from ltm_core.pose_estimation.skyline.contour_scores import (
    MOST_POINTS,
    RIDGE_WEIGHT,
    SPREAD,
    ContourDirections,
    PictureEvidence,
    contour_scores,
    ridge_gain,
    ridge_strength,
)
from ltm_core.pose_estimation.skyline.picture_pose_config import CrestCover, Criteria, crest_heights
from ltm_core.pose_estimation.skyline.pose_hypothesis import MANY_PLANTS, Hypothesis, focal_candidates, search_reach
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.pose_estimation.skyline.pose_refinement import ROUNDS, RefinedPose, refine
from ltm_core.pose_estimation.skyline.skyline_search import search_azimuths

_KEPT = 18
_ROCK = crest_heights(tree=(0.3, 0.4), shrub=(0.3, 0.4), grass=(0.2, 0.3), bare=(0.1, 0.3), other=(0.2, 0.3))
_ANY = CrestCover(_ROCK, _ROCK)  # for all labels if few are plants: rock and ice, which labels know least
_ALONG = 8.0  # metres and pixels within which errors of a ridge of rock are fully correlated
_FLOOR_DEG = (0.15, 0.05, 0.15)  # minimum sigmas in degrees; all edges along a ridge may belong to something else
_MOST_POINTS = 1000
_COARSE_POINTS = 500
_NEARBY = np.array([(a, p, r) for a in (-0.25, 0.0, 0.25) for p in (-0.1, 0.0, 0.1) for r in (-0.4, 0.0, 0.4)])
"""Degrees around each of the coarse grid's best poses at which finer edges are used."""
_RESTARTS = np.array(
    [(0.0, 0.0, 1.2), (0.0, 0.0, 0.6), (0.2, -0.1, 0.6), (0.5, -0.2, 1.2), (0.8, 0.0, 0.0), (0.0, 0.4, 0.4)]
)
"""Degrees: along a ridge that runs up through the image, azimuth, pitch and roll compensate."""
_ROUNDS = tuple((reach, 1.0) for reach in (16.0, 12.0, 10.0, 8.0, 6.0, 5.0, 4.0, 4.0, 4.0))
_SETTLING = ((4.0, 1.0),) * 12  # rounds of both, as in `pose_refinement.ROUNDS`


def search_ridges(problem: PoseProblem) -> list[Hypothesis]:
    """Return hypotheses in order of cost, without the skyline; none if too few ridges may be in view."""
    evidence, horizon, prior = problem.evidence, problem.horizon, problem.prior
    if evidence.plants < MANY_PLANTS:
        horizon = replace(horizon, cover=_ANY)
    problem = replace(problem, evidence=replace(evidence, skyline=None), horizon=horizon, along=_ALONG)
    ridges = ContourDirections.of(horizon, with_horizon=True)
    if len(ridges.range) < 30:
        return []
    reach = 180.0
    if prior.heading_known:
        reach = min(2.5 * prior.azimuth_sigma_deg, math.degrees(search_reach(prior)))
    steps = _steps(reach, 0.5), _steps(2.5 * prior.pitch_sigma_deg, 0.2), _steps(2.5 * prior.roll_sigma_deg, 1.0)
    grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3) + prior.pose.angles_deg
    points = ridges.thinned(max(1, len(ridges.range) // _MOST_POINTS))
    few = ridges.thinned(max(1, len(ridges.range) // _COARSE_POINTS))
    found: list[tuple[float, Float64Array, Camera]] = []
    for factor in focal_candidates(problem.focal_sigma):
        lens = evidence.camera.zoomed(factor)
        scores = contour_scores(_rotations(grid), few, lens, evidence.coarse_edges)[0] - _prior_cost(grid, prior)
        first = grid[np.argsort(-scores)[: 16 * _KEPT]]
        nearby = (first[:, None] + _NEARBY).reshape(-1, 3)
        scores = contour_scores(_rotations(nearby), points, lens, evidence.edges)[0] - _prior_cost(nearby, prior)
        scores, each = scores.reshape(len(first), -1), nearby.reshape(len(first), -1, 3)
        best = scores.argmax(axis=1)
        found += [(float(scores[k, j]), each[k, j], lens) for k, j in enumerate(best.tolist())]
    found.sort(key=lambda entry: -entry[0])

    def refined_from(start: Pose, lens: Camera, rounds: tuple[tuple[float, float], ...]) -> RefinedPose:
        around = ridges.in_view(start, lens, _MOST_POINTS)
        refined = refine(start, lens, problem, around, rounds)
        covariance = refined.covariance.copy()
        covariance[3:6, 3:6] += pose_covariance(refined.pose, 0.0, 0.0, *_FLOOR_DEG)[3:, 3:]
        return replace(refined, covariance=covariance)

    hypotheses: list[Hypothesis] = []
    starts = _apart([(angles, lens) for _, angles, lens in found])
    for _ in range(4):
        for angles, lens in starts:
            start = Pose.from_angles(prior.pose.position, *(float(a) for a in angles))
            refined = refined_from(start, lens, _ROUNDS)
            z = ridge_strength(refined.pose, ridges, horizon.step, refined.camera, evidence.edges)
            cost = refined.cost - RIDGE_WEIGHT * max(z, 0.0) ** 2 / 2
            hypotheses.append(Hypothesis(refined, cost, z))
        hypotheses.sort(key=lambda hypothesis: hypothesis.cost)
        # Again from about the best: what a wrong roll trapped gets out.
        best = hypotheses[0].refined
        at = np.array(best.pose.angles_deg)
        starts = [(at + sign * offset, best.camera) for offset in _RESTARTS for sign in (1.0, -1.0)]
    # Rounds end before a pose has settled where azimuth and roll make up for each other. It is judged as it was found,
    # as the others are.
    hypotheses[0] = replace(hypotheses[0], refined=refined_from(best.pose, best.camera, _SETTLING))
    kept: list[Hypothesis] = []
    for one in hypotheses:
        off = (np.abs(angles_between(one.refined.pose, other.refined.pose)).max() for other in kept)
        if all(away > math.radians(0.3) for away in off):
            kept.append(one)
    return kept


def _rotations(angles_deg: Float64Array) -> Float64Array:
    """Return (P, 3, 3), optical to map, of azimuth, pitch and roll (P, 3), as `Pose.from_angles` has them."""
    return matrix_of_angles("ZXZ", angles_deg * (-1.0, 1.0, 1.0) - (0.0, 90.0, 0.0), degrees=True)


def _steps(reach: float, step: float) -> Float64Array:
    n = max(1, math.ceil(reach / step))
    return np.asarray(step * np.arange(-n, n + 1), np.float64)


def _prior_cost(grid: Float64Array, prior: PosePrior) -> Float64Array:
    away = np.abs(grid - np.array(prior.pose.angles_deg))
    away[:, 0] = np.minimum(away[:, 0], 360 - away[:, 0])
    sigma = np.array([prior.azimuth_sigma_deg, prior.pitch_sigma_deg, prior.roll_sigma_deg])
    if not prior.heading_known:
        sigma[0] = np.inf
    return np.asarray(0.25 * ((away / sigma) ** 2).sum(axis=1), np.float64)


def _apart(found: list[tuple[Float64Array, Camera]]) -> list[tuple[Float64Array, Camera]]:
    kept: list[tuple[Float64Array, Camera]] = []
    for angles, lens in found:
        same = (other for other, another in kept if lens is another)
        apart = all(float(np.abs((angles - other) / (1.0, 0.6, 1.2)).max()) >= 0.99 for other in same)
        if apart and len(kept) < _KEPT:
            kept.append((angles, lens))
    return kept


_STEP_DEG, _WIDE_STEP_DEG = 0.25, 0.4  # steps of azimuth of the search; the wide one if no heading is known
_STARTS = (8, 1.2), (14, 0.5)
"""Number of best poses that are refined, and their minimum distance in azimuth in degrees. Far ridges are periodic,
with one local optimum per peak, and the best pose of the grid need not be the best after refinement: therefore the
closer ones."""
_SKYLINE_SETTLING = ((3.0, 1.0),) * 6  # further rounds, as in `ROUNDS`
_PITCHES_DEG = (-0.45, -0.3, -0.15, 0.0, 0.15, 0.3, 0.45)


def poses_on_skyline(problem: PoseProblem) -> list[Hypothesis]:
    """Return hypotheses in order of cost for an image with a skyline."""
    evidence, horizon, prior = problem.evidence, problem.horizon, problem.prior
    skyline = evidence.skyline
    assert skyline is not None  # nosec B101 # tells the type checker what holds
    reach = search_reach(prior)
    step = math.radians(_STEP_DEG if prior.heading_known else _WIDE_STEP_DEG)
    azimuth, pitch, roll = prior.pose.angles_deg
    n = math.ceil(reach / step)
    azimuths = np.asarray(math.radians(azimuth) + step * np.arange(-n, n + 1), np.float64)
    ridges = ContourDirections.of(horizon)
    coarse = ridges.thinned(max(1, len(ridges.range) // (MOST_POINTS * (6 if horizon.whole else 2))))
    position_sigma = 0.5 * prior.position_sigma
    candidates = []
    for factor in focal_candidates(problem.focal_sigma):
        camera = evidence.camera.zoomed(factor)
        cost, *tilts = search_azimuths(skyline, camera, prior, horizon, azimuths, position_sigma)
        angles = np.degrees(np.column_stack([azimuths, *tilts])) + np.array([0.0, pitch, roll])
        scores = _best_over_pitch(_rotations(angles), coarse, camera, evidence)
        candidates.append((camera, angles, cost, scores))
    every = np.concatenate([scores for *_, scores in candidates])
    usual = float(np.median(every))
    spread = max(1.4826 * float(np.median(np.abs(every - usual))), SPREAD)
    ranked: list[tuple[float, Float64Array, Camera]] = []
    for camera, angles, cost, scores in candidates:
        total = cost - ridge_gain((scores - usual) / spread)
        if prior.heading_known:
            away = (angles[:, 0] - azimuth + 180.0) % 360.0 - 180.0
            total += 0.5 * (away / prior.azimuth_sigma_deg) ** 2
        ranked += [(float(c), at, camera) for c, at in zip(total, angles, strict=True)]
    ranked.sort(key=lambda entry: entry[0])
    starts: list[tuple[Pose, Camera]] = []
    for most, apart_deg in _STARTS:
        for _, at, camera in ranked:
            if len(starts) == most:
                break
            pose = Pose.from_angles(prior.pose.position, *(float(a) for a in at))
            if all(abs(angles_between(pose, other)[0]) >= math.radians(apart_deg) for other, _ in starts):
                starts.append((pose, camera))

    def hypothesis_from(pose: Pose, camera: Camera, rounds: tuple[tuple[float, float], ...]) -> Hypothesis:
        around = ridges.in_view(pose, camera)
        refined = refine(pose, camera, problem, around, rounds)
        score, _ = contour_scores(refined.pose.rotation[None], coarse, refined.camera, evidence.coarse_edges)
        z = (float(score[0]) - usual) / spread
        return Hypothesis(refined, refined.cost - float(ridge_gain(z)), z)

    found = sorted((hypothesis_from(*start, ROUNDS) for start in starts), key=lambda hypothesis: hypothesis.cost)
    # Along a smooth slope a pose has not settled when its rounds end: those that the mean will be of go on.
    near = math.radians(Criteria.alternative_deg)
    middle = found[0].refined.pose
    found = [
        hypothesis_from(h.refined.pose, h.refined.camera, _SKYLINE_SETTLING)
        if abs(angles_between(middle, h.refined.pose)[0]) <= near
        else h
        for h in found
    ]
    return sorted(found, key=lambda hypothesis: hypothesis.cost)


def _best_over_pitch(
    rotations: Float64Array, ridges: ContourDirections, camera: Camera, evidence: PictureEvidence
) -> Float64Array:
    """Return the ridge scores (P,) of rotations (P, 3, 3), each at the best of some pitches about its own."""
    best = np.full(len(rotations), -np.inf)
    for offset in _PITCHES_DEG:
        c, s = math.cos(math.radians(offset)), math.sin(math.radians(offset))
        up = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])  # about the camera's x axis
        best = np.maximum(best, contour_scores(rotations @ up, ridges, camera, evidence.coarse_edges)[0])
    return best
