"""One picture with a disturbed pose: what is found in it, and how far that is from the truth."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, SearchTerrain, find_pose
from ltm_core.pose_estimation.skyline.picture_evidence import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angle_slopes, angles_between
from ltm_core.tracing import TerrainTracer
from ltm_lab.evaluation.pose.disturbance import Sensor, disturbed
from ltm_lab.evaluation.truth_frames_io import TruthFrame

_ABOUT_A_KILOMETRE = (700.0, 1400.0)
_TRACED_WIDTH = 160


@dataclass(frozen=True)
class PoseTrial:
    """`before`, `after`: errors of azimuth, pitch and roll, degrees, of the pose that came in and of the best that was
    found; `z`: the latter in its own sigmas. `open_share`: of the horizon in view, over which land beyond the DEM may
    stand. `traced`, `traced_before`: metres, median, between the places of pixels that see ground at about 1 km and
    where the pose puts them; NaN where none does. `veiled`: the share of the horizon that plants on near crests may
    hide. `focal`: the
    focal length found over the true one. `seconds`: of CPU.
    """

    frame: str
    sensor: Sensor
    verdict: str
    before: tuple[float, float, float]
    after: tuple[float, float, float]
    z: tuple[float, float, float]
    gap: float
    support: float
    veiled: float
    sigma: tuple[float, float, float]
    open_share: float
    traced_before: float
    traced: float
    focal: float
    seconds: float
    hypotheses: tuple[tuple[float, float, float], ...]
    """Of the first few: cost, ridge score, error of azimuth in degrees."""

    @property
    def accepted(self) -> bool:
        return self.verdict == "accepted"


@dataclass(frozen=True, eq=False)
class PreparedFrame:
    """A frame with what its picture shows, and the share of its horizon that is open."""

    name: str
    frame: TruthFrame
    evidence: PictureEvidence
    open_share: float
    seconds: float


def prepared(
    name: str, frame: TruthFrame, labels: UInt8Array, terrain: SearchTerrain, config: PicturePoseConfig
) -> PreparedFrame:
    """`labels`: (H, W) as the search gets them."""
    begin = time.process_time()
    evidence = picture_evidence(frame.photo, labels, frame.camera, config)
    spent = time.process_time() - begin
    exact = PosePrior(frame.pose, 1.0)
    horizon = terrain.horizon_for(evidence.camera, exact, config)
    half = math.radians(frame.camera.hfov_deg) / 2
    away = (horizon.azimuths - math.radians(frame.pose.angles_deg[0]) + math.pi) % (2 * math.pi) - math.pi
    return PreparedFrame(name, frame, evidence, float(horizon.open[np.abs(away) < half].mean()), spent)


def run_trial(
    prepared_frame: PreparedFrame,
    sensor: Sensor,
    terrain: SearchTerrain,
    tracer: TerrainTracer | None,
    config: PicturePoseConfig,
    rng: np.random.Generator,
    focal_factor: float = 1.0,
    focal_sigma: float = 0.0,
) -> tuple[PoseTrial, PictureSearch, PosePrior]:
    """Disturb the pose of a frame, and its focal length by a factor, and search it."""
    frame = prepared_frame.frame
    evidence = prepared_frame.evidence.unseen
    prior = disturbed(frame.pose, sensor, terrain.dem, rng)
    if focal_factor != 1.0:
        evidence = replace(evidence, camera=evidence.camera.zoomed(focal_factor))
    begin = time.process_time()
    search = find_pose(evidence, terrain, prior, config, focal_sigma)
    spent = time.process_time() - begin + prepared_frame.seconds
    found = search.hypotheses[0].refined if search.hypotheses else None
    pose = prior.pose if found is None else found.pose
    after = np.degrees(angles_between(frame.pose, pose))
    sigma = np.full(3, np.inf)
    if found is not None:
        slopes = angle_slopes(pose)
        sigma = np.degrees(np.sqrt(np.diag(slopes @ found.covariance[3:6, 3:6] @ slopes.T)))
    before = np.degrees(angles_between(frame.pose, prior.pose))
    near = near_a_kilometre(frame)
    trial = PoseTrial(
        prepared_frame.name,
        sensor,
        search.verdict.word,
        _three(before),
        _three(after),
        _three(after / sigma),
        search.verdict.gap,
        search.verdict.support,
        0.0 if found is None else found.skyline.veiled,
        _three(sigma),
        prepared_frame.open_share,
        traced_error(frame, near, prior.pose, tracer),
        traced_error(frame, near, pose, tracer),
        1.0 if found is None else found.camera.fx / prepared_frame.evidence.camera.fx,
        spent,
        tuple(
            (h.cost, h.ridge_score, float(np.degrees(angles_between(frame.pose, h.refined.pose)[0])))
            for h in search.hypotheses[:4]
        ),
    )
    return trial, search, prior


def near_a_kilometre(frame: TruthFrame) -> tuple[Float64Array, Float64Array]:
    """Optical rays (K, 3) of some pixels that see bare ground at about 1 km, and its places (K, 3)."""
    depth = frame.ground
    step = max(1, depth.shape[1] // _TRACED_WIDTH)
    rays = frame.camera.scaled(frame.step).rays()[::step, ::step]
    z = depth[::step, ::step].astype(np.float64)
    ranges = z / rays[..., 2]
    seen = (ranges > _ABOUT_A_KILOMETRE[0]) & (ranges < _ABOUT_A_KILOMETRE[1])
    with np.errstate(invalid="ignore"):  # sky against sky
        seen &= np.abs(frame.surface[::step, ::step] - z) < 0.02 * z  # no tree before it
    return rays[seen], frame.pose.to_map(rays[seen] * ranges[seen][:, None])


def traced_error(
    frame: TruthFrame, near: tuple[Float64Array, Float64Array], pose: Pose, tracer: TerrainTracer | None
) -> float:
    """Median metres between where pixels are traced to by `pose` and where they are traced to by the true pose."""
    rays, _ = near
    if tracer is None or len(rays) < 20:
        return math.nan
    some = rays[:: max(1, len(rays) // 300)]
    places = []
    for at in (frame.pose, pose):
        if not tracer.ground_clearance(at) > 0:
            return math.nan
        directions = some @ at.rotation.T
        ranges = tracer.trace_rays(at.position, directions).astype(np.float64)
        places.append(at.position + directions * np.where(np.isfinite(ranges), ranges, np.nan)[:, None])
    away = np.hypot(*(places[0] - places[1])[:, :2].T)
    known = np.isfinite(away)
    return float(np.median(away[known])) if known.sum() >= 20 else math.nan


def _three(values: Float64Array) -> tuple[float, float, float]:
    a, b, c = (float(v) for v in values)
    return a, b, c
