"""Find a pose, a focal length and k1 together, because a wrong lens makes every pose ambiguous."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import vector_of_matrix
from ltm_core.pose_estimation.lens import LensPrior
from ltm_core.pose_estimation.skyline.contour_scores import ContourDirections, PictureEvidence
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, SearchTerrain, find_pose
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.pose_estimation.skyline.pose_refinement import RefinedPose, refine
from ltm_core.pose_estimation.skyline.pose_search import poses_on_skyline

_STEP, _REACH = 0.5, 2.0  # step and reach of the search of k1, in its standard deviations
_HALVINGS, _FOLLOWED = 4, 4  # number of steps to the best k1, and of poses that are followed in each
_FOCAL_LEFT = 0.005  # relative standard deviation of the focal length once k1 is found


@dataclass(frozen=True, eq=False)
class _Trial:
    """A pose with its k1, and its cost with that of k1."""

    k1: float
    refined: RefinedPose
    cost: float


def find_pose_and_lens(
    evidence_of: Callable[[Camera], PictureEvidence],
    camera: Camera,
    terrain: SearchTerrain,
    prior: PosePrior,
    lens: LensPrior,
    config: PicturePoseConfig = PicturePoseConfig(),
) -> tuple[PictureSearch, Camera]:
    """Search the pose, the focal length and k1 of an image; return the search and the image's camera with the lens.

    `evidence_of`: evidence in the image by its camera, which undistorts it. Every k1 within two standard deviations is
    searched on the skyline. The best pose is followed to the k1 of least cost. The pose is then searched with that
    lens; the poses of other lenses widen it by their weights, and their azimuths are alternatives to it. Without a
    skyline, the lens stays as stated."""
    horizon = terrain.horizon_for(camera, prior, config)
    ridges = ContourDirections.of(horizon, config.contours.nearest)
    middle = camera.distortion[0]

    def with_k1(k1: float) -> Camera:
        return replace(camera, distortion=(k1, *camera.distortion[1:]))

    def problem(evidence: PictureEvidence) -> PoseProblem:
        return PoseProblem(evidence, horizon, prior, config, lens.focal)

    def trial(k1: float, refined: RefinedPose) -> _Trial:
        return _Trial(k1, refined, refined.cost + 0.5 * ((k1 - middle) / lens.k1) ** 2)

    def followed(start: _Trial, k1: float) -> _Trial:
        evidence = evidence_of(with_k1(k1))
        pose, work = start.refined.pose, start.refined.camera
        around = ridges.in_view(pose, work, config.contours.most_points)
        return trial(k1, refine(pose, work, problem(evidence), around))

    trials: list[_Trial] = []
    for step in np.arange(-_REACH, _REACH + _STEP / 2, _STEP):
        k1 = middle + float(step) * lens.k1
        evidence = evidence_of(with_k1(k1))
        if evidence.skyline is not None:
            found = terrain.above(poses_on_skyline(problem(evidence)))
            trials += [trial(k1, h.refined) for h in found]
    if not trials:
        return find_pose(evidence_of(camera), terrain, prior, config, lens.focal, horizon), camera
    # The best are followed to neighbouring k1: the grid of focal lengths finds each within its own errors.
    step = _STEP * lens.k1
    for _ in range(_HALVINGS):
        step /= 2
        trials.sort(key=lambda t: t.cost)
        trials += [followed(t, t.k1 + sign * step) for t in trials[:_FOLLOWED] for sign in (-1.0, 1.0)]
    best = min(trials, key=lambda t: t.cost)
    evidence = evidence_of(with_k1(best.k1))
    zoom = best.refined.camera.fx / evidence.camera.fx
    evidence = replace(evidence, camera=evidence.camera.zoomed(zoom))
    search = find_pose(evidence, terrain, prior, config, _FOCAL_LEFT, horizon)
    return _with_other_lenses(search, trials, best, config), with_k1(best.k1).zoomed(zoom)


def _with_other_lenses(
    search: PictureSearch, trials: list[_Trial], best: _Trial, config: PicturePoseConfig
) -> PictureSearch:
    """Return the search with the spread of the poses of other lenses in its covariance, and its verdict by it."""
    if not search.hypotheses:
        return search
    v, verdict = config.verdict, search.verdict
    first, *others = search.hypotheses
    variance = first.refined.skyline.variance
    weights: list[float] = []
    turns: list[Float64Array] = []
    for trial in sorted(trials, key=lambda t: t.cost):
        pose, gap = trial.refined.pose, trial.cost - best.cost
        if abs(float(angles_between(first.refined.pose, pose)[0])) <= math.radians(v.alternative_deg):
            turn = vector_of_matrix(pose.rotation @ best.refined.pose.rotation.T)
            # Starts that ended in one place are one pose.
            if all(float(np.abs(turn - other).max()) > math.radians(v.same_deg) for other in turns):
                weights.append(math.exp(-gap / (v.agreement * variance)))
                turns.append(turn)
        elif verdict.word == "accepted" and gap < v.gap_asked(first.refined.skyline.veiled, variance):
            reason = f"with a lens of k1 {trial.k1:+.2f}, azimuth {pose.angles_deg[0]:.1f} deg costs {gap:.1f} more"
            verdict = replace(verdict, word="ambiguous", reason=reason, gap=gap)
    covariance = first.refined.covariance.copy()
    if weights:
        away = np.array(turns)
        covariance[3:6, 3:6] += (away.T * np.array(weights)) @ away / sum(weights)
    refined = replace(first.refined, covariance=covariance)
    verdict = replace(verdict, sigma_deg=refined.sigma_deg)
    if verdict.word == "accepted" and max(refined.sigma_deg) > v.most_sigma_deg:
        sigmas = ", ".join(f"{sigma:.2f}" for sigma in refined.sigma_deg)
        reason = f"other lenses fit as well: azimuth, pitch, roll are known only to {sigmas} deg"
        verdict = replace(verdict, word="ambiguous", reason=reason)
    return replace(search, hypotheses=(replace(first, refined=refined), *others), verdict=verdict)
