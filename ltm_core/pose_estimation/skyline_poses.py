"""Searches a pose by the skyline, with the ridges below it: all azimuths within reach, the best of them refined."""

from __future__ import annotations

import math

import numpy as np

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.pose_estimation.contour_scores import ContourDirections, contour_scores, usual_score
from ltm_core.pose_estimation.picture_evidence import PictureEvidence
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.pose_hypothesis import Hypothesis, focal_candidates, search_reach
from ltm_core.pose_estimation.pose_prior import PosePrior, angles_between, rotations_of
from ltm_core.pose_estimation.pose_refinement import ROUNDS, refine
from ltm_core.pose_estimation.skyline_search import search_azimuths
from ltm_core.pose_estimation.terrain_horizon import TerrainHorizon
from ltm_core.types import Float64Array

_SETTLING = ((3.0, 1.0),) * 6
"""As `ROUNDS`: further ones."""
_PITCHES_DEG = (-0.45, -0.3, -0.15, 0.0, 0.15, 0.3, 0.45)


def poses_on_skyline(
    evidence: PictureEvidence,
    horizon: TerrainHorizon,
    prior: PosePrior,
    config: PicturePoseConfig,
    focal_sigma: float,
) -> list[Hypothesis]:
    """Hypotheses from the best down, of a picture that shows a skyline."""
    s, skyline = config.search, evidence.skyline
    assert skyline is not None  # nosec B101 # tells the type checker what holds
    reach = search_reach(prior, config)
    step = math.radians(s.step_deg if prior.heading_known else s.wide_step_deg)
    azimuth, pitch, roll = prior.pose.angles_deg
    n = math.ceil(reach / step)
    azimuths = np.asarray(math.radians(azimuth) + step * np.arange(-n, n + 1), np.float64)
    ridges = ContourDirections.of(horizon, config.contours.nearest)
    coarse = ridges.thinned(max(1, len(ridges.range) // (config.contours.most_points * (6 if horizon.whole else 2))))
    position_sigma = 0.5 * prior.position_sigma
    candidates = []
    for factor in focal_candidates(focal_sigma):
        camera = evidence.camera.zoomed(factor)
        costs = search_azimuths(
            skyline,
            camera,
            pitch,
            roll,
            (math.radians(prior.pitch_sigma_deg), math.radians(prior.roll_sigma_deg)),
            horizon,
            azimuths,
            position_sigma,
            config.skyline,
        )
        angles = np.degrees(np.column_stack([costs.azimuth, costs.pitch, costs.roll])) + np.array([0.0, pitch, roll])
        scores = _best_over_pitch(rotations_of(angles), coarse, camera, evidence)
        candidates.append((camera, angles, costs.cost, scores))
    everything = np.concatenate([scores for *_, scores in candidates])
    usual, spread = usual_score(everything)
    ranked: list[tuple[float, Float64Array, Camera]] = []
    for camera, angles, cost, scores in candidates:
        total = cost + _heading_cost(angles[:, 0], prior) + _ridge_cost(scores, usual, spread, config)
        ranked += list(zip(total.tolist(), angles, [camera] * len(angles), strict=True))
    ranked.sort(key=lambda entry: entry[0])
    starts: list[tuple[Pose, Camera]] = []
    for most, apart_deg in ((s.hypotheses, s.apart_deg), (s.hypotheses + s.teeth, s.teeth_apart_deg)):
        for _, at, camera in ranked:
            if len(starts) == most:
                break
            pose = Pose.from_angles(prior.pose.position, *(float(a) for a in at))
            if all(abs(angles_between(pose, other)[0]) >= math.radians(apart_deg) for other, _ in starts):
                starts.append((pose, camera))

    def hypothesis_from(pose: Pose, camera: Camera, rounds: tuple[tuple[float, float], ...]) -> Hypothesis:
        around = ridges.in_view(pose, camera, config.contours.most_points)
        refined = refine(pose, camera, evidence, horizon, around, prior, focal_sigma, config, rounds)
        score = float(contour_scores(refined.pose.rotation[None], coarse, refined.camera, evidence.coarse_edges)[0])
        ridge = float(_ridge_cost(np.array([score]), usual, spread, config)[0])
        return Hypothesis(refined, refined.cost + ridge, (score - usual) / spread)

    found = sorted((hypothesis_from(*start, ROUNDS) for start in starts), key=lambda hypothesis: hypothesis.cost)
    # Along a smooth slope a pose has not settled when its rounds end: those that the mean will be of go on.
    near = math.radians(config.verdict.alternative_deg)
    middle = found[0].refined.pose
    found = [
        hypothesis_from(h.refined.pose, h.refined.camera, _SETTLING)
        if abs(angles_between(middle, h.refined.pose)[0]) <= near
        else h
        for h in found
    ]
    return sorted(found, key=lambda hypothesis: hypothesis.cost)


def _best_over_pitch(
    rotations: Float64Array,
    ridges: ContourDirections,
    camera: Camera,
    evidence: PictureEvidence,
) -> Float64Array:
    """Ridge scores (P,) of rotations (P, 3, 3), each at the best of some pitches about its own."""
    best = np.full(len(rotations), -np.inf)
    for offset in _PITCHES_DEG:
        c, s = math.cos(math.radians(offset)), math.sin(math.radians(offset))
        up = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])  # about the camera's x axis
        best = np.maximum(best, contour_scores(rotations @ up, ridges, camera, evidence.coarse_edges))
    return best


def _ridge_cost(scores: Float64Array, usual: float, spread: float, config: PicturePoseConfig) -> Float64Array:
    z = np.clip((scores - usual) / spread, 0.0, config.contours.most)
    return np.asarray(-config.contours.weight * z * z / 2, np.float64)


def _heading_cost(azimuths_deg: Float64Array, prior: PosePrior) -> Float64Array:
    if not prior.heading_known:
        return np.zeros(len(azimuths_deg))
    away = (azimuths_deg - prior.pose.angles_deg[0] + 180.0) % 360.0 - 180.0
    return np.asarray(0.5 * (away / prior.azimuth_sigma_deg) ** 2, np.float64)
