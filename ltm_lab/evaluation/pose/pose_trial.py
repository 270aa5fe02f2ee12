"""Trials of single poses: a true pose is disturbed as by a sensor, searched in the image, and scored."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain, find_pose
from ltm_core.pose_estimation.skyline.pose_prior import UNKNOWN_DEG, PosePrior, angle_slopes, angles_between
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_lab.evaluation.pose.rendered_terrain_io import PreparedFrame, RenderedSite
from ltm_lab.frames.truth_frames_io import TruthFrame

OPEN = 0.5
"""Smallest share of the open horizon of a view that counts as open."""
INSIDE = 0.1
"""Largest share of the open horizon of a view whose skyline counts as inside the DEM."""
_PHONE_HEIGHT = 1.5
"""Smallest height of a phone over the ground, metres, whatever its barometer says."""
_ABOUT_A_KILOMETRE = (700.0, 1400.0)
_TRACED_WIDTH = 160
Angles = tuple[float, float, float]
"""Azimuth, pitch and roll."""


class Sensor(StrEnum):
    """What a pose was read from."""

    mount = "mount"
    """A surveyed mast: azimuth 1.5 deg, pitch and roll 0.5; its place is exact."""
    phone = "phone"
    """Compass 6 deg, with one in five drawn from 12 and none beyond 15; pitch and roll 0.7; GPS 5 m, height 4 m."""
    unknown = "no heading"
    """A mount of which no azimuth is known."""


@dataclass(frozen=True)
class PoseJob:
    """A rendered site, whose frames are each disturbed `draws` times as by each of the sensors; focal lengths are off
    by up to the share `focal`. `mounts`: the frames of each camera are also the presets of a PTZ head."""

    site: RenderedSite
    sensors: tuple[Sensor, ...]
    draws: int
    focal: float
    mounts: bool
    seed: int

    def rng(self, *parts: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, *parts, *self.site.folder.name.encode()])

    def focal_factor(self, rng: np.random.Generator) -> float:
        return 1.0 + self.focal * rng.uniform(-1, 1) if self.focal else 1.0


@dataclass(frozen=True)
class PoseTrial:
    """One disturbed pose and the best pose that was found.

    `before`, `after`: errors of the disturbed and the found angles, degrees; `z`: the latter over their sigmas.
    `open_share`: share of the horizon in view beyond which land outside the DEM may stand. `traced_before`, `traced`:
    median distance in metres between the places at about 1 km to which true and disturbed or found pose trace a pixel,
    NaN if no pixel sees any. `focal`: found focal length over the true one. `seconds`: processor time."""

    frame: str
    sensor: Sensor
    verdict: str
    before: Angles
    after: Angles
    z: Angles
    gap: float
    support: float
    open_share: float
    traced_before: float
    traced: float
    focal: float
    seconds: float

    @property
    def accepted(self) -> bool:
        return self.verdict == "accepted"


def run_pose_trials(job: PoseJob, terrain: SearchTerrain, frames: Sequence[PreparedFrame]) -> list[PoseTrial]:
    """Run the trials of all frames of a site."""
    tracer = TerrainTracer(terrain.dem, terrain.bend > 0, possible=terrain.possible)
    trials = []
    for frame in frames:
        for kind, sensor in enumerate(job.sensors):
            rng = job.rng(frame.number, kind)
            for _ in range(job.draws):
                factor = job.focal_factor(rng)
                trial = run_trial(frame, sensor, terrain, tracer, rng, factor, 0.5 * job.focal)
                trials.append(replace(trial, frame=f"{job.site.folder.name}/{frame.number:04d}"))
    return trials


def disturbed(pose: Pose, sensor: Sensor, dem: Dem, rng: np.random.Generator) -> PosePrior:
    """Return a true pose as the sensor has it, with the sigmas that it states."""
    azimuth, pitch, roll = pose.angles_deg
    turn, tilt, tail = rng.normal(), rng.normal(size=2), rng.uniform()
    shift, height = rng.normal(size=2), rng.normal()
    if sensor is not Sensor.phone:
        known = sensor is Sensor.mount
        azimuth = azimuth + 1.5 * turn if known else 360.0 * rng.uniform()
        told = Pose.from_angles(pose.position, azimuth, pitch + 0.5 * tilt[0], roll + 0.5 * tilt[1])
        return PosePrior(told, 1.5 if known else UNKNOWN_DEG, 0.5, 0.5)
    away = float(np.clip((12.0 if tail < 0.2 else 6.0) * turn, -15.0, 15.0))
    x, y = pose.position[:2] + 5.0 * shift
    ground = float(dem.elevation_at(x, y))
    z = float(pose.position[2] + 4.0 * height)
    z = max(z, ground + _PHONE_HEIGHT) if np.isfinite(ground) else z
    told = Pose.from_angles((x, y, z), azimuth + away, pitch + 0.7 * tilt[0], roll + 0.7 * tilt[1])
    return PosePrior(told, 6.0, 0.7, 0.7, 5.0, 4.0)


def run_trial(
    prepared: PreparedFrame,
    sensor: Sensor,
    terrain: SearchTerrain,
    tracer: TerrainTracer,
    rng: np.random.Generator,
    focal_factor: float = 1.0,
    focal_sigma: float = 0.0,
) -> PoseTrial:
    """Disturb the pose of a frame, and its focal length by a factor, and search the pose in the image."""
    frame, evidence = prepared.frame, prepared.unseen
    prior = disturbed(frame.pose, sensor, terrain.dem, rng)
    if focal_factor != 1.0:
        evidence = replace(evidence, camera=evidence.camera.zoomed(focal_factor))
    begin = time.process_time()
    search = find_pose(evidence, terrain, prior, focal_sigma)
    spent = time.process_time() - begin + prepared.seconds
    found = search.hypotheses[0].refined if search.hypotheses else None
    pose = prior.pose if found is None else found.pose
    after, sigma = np.degrees(angles_between(frame.pose, pose)), np.full(3, np.inf)
    if found is not None:
        sigma = sigmas_deg(pose, found.covariance)
    rays = rays_at_a_kilometre(frame)
    return PoseTrial(
        frame.camera_name,
        sensor,
        search.verdict.word,
        three(np.degrees(angles_between(frame.pose, prior.pose))),
        three(after),
        three(after / sigma),
        search.verdict.gap,
        search.verdict.support,
        prepared.open_share,
        traced_error(frame.pose, rays, prior.pose, tracer),
        traced_error(frame.pose, rays, pose, tracer),
        1.0 if found is None else found.camera.fx / prepared.evidence.camera.fx,
        spent,
    )


def sigmas_deg(pose: Pose, covariance: Float64Array) -> Float64Array:
    """Return the standard deviations (3,) of azimuth, pitch and roll, degrees, of a (6, 6) covariance."""
    slopes = angle_slopes(pose)
    return np.asarray(np.degrees(np.sqrt(np.diag(slopes @ covariance[3:6, 3:6] @ slopes.T))), np.float64)


def rays_at_a_kilometre(frame: TruthFrame) -> Float64Array:
    """Return the optical rays (K, 3) of some pixels that see bare ground at about 1 km."""
    depth = frame.ground
    step = max(1, depth.shape[1] // _TRACED_WIDTH)
    rays = frame.camera.scaled(frame.step).rays()[::step, ::step]
    z = depth[::step, ::step].astype(np.float64)
    ranges = z / rays[..., 2]
    seen = (ranges > _ABOUT_A_KILOMETRE[0]) & (ranges < _ABOUT_A_KILOMETRE[1])
    with np.errstate(invalid="ignore"):  # sky against sky
        seen &= np.abs(frame.surface[::step, ::step] - z) < 0.02 * z  # no tree before it
    return np.asarray(rays[seen], np.float64)


def traced_error(true: Pose, rays: Float64Array, pose: Pose, tracer: TerrainTracer) -> float:
    """Return the median metres between the places to which two poses trace the rays; NaN if too few hit ground."""
    if len(rays) < 20:
        return math.nan
    some = rays[:: max(1, len(rays) // 300)]
    places = []
    for at in (true, pose):
        if not at.position[2] > tracer.dem.elevation_at(*at.position[:2]):
            return math.nan
        directions = some @ at.rotation.T
        ranges = tracer.trace_rays(at.position, directions).astype(np.float64)
        places.append(at.position + directions * np.where(np.isfinite(ranges), ranges, np.nan)[:, None])
    away = np.hypot(*(places[0] - places[1])[:, :2].T)
    known = np.isfinite(away)
    return float(np.median(away[known])) if known.sum() >= 20 else math.nan


def three(values: Float64Array) -> Angles:
    a, b, c = (float(v) for v in values)
    return a, b, c


@dataclass(frozen=True)
class Spread:
    """Median, 90th percentile and maximum of absolute values; NaN of none."""

    median: float
    p90: float
    greatest: float

    @classmethod
    def of(cls, values: Sequence[float] | Float64Array) -> "Spread":
        known = np.abs(np.asarray(values, np.float64))
        known = known[np.isfinite(known)]
        if known.size == 0:
            return cls(np.nan, np.nan, np.nan)
        return cls(float(np.median(known)), float(np.percentile(known, 90)), float(known.max()))

    def __str__(self) -> str:
        return f"{self:.2f}"

    def __format__(self, spec: str) -> str:
        return f"{self.median:{spec}} / {self.p90:{spec}} / {self.greatest:{spec}}"


@dataclass(frozen=True)
class PoseScore:
    """Errors of the accepted poses, in degrees and metres. `angles`: of azimuth, pitch and roll. `z`: 1.48 median
    |error / sigma| of each, which is 1 if sigmas are right. `wrong_by_1`, `wrong_by_2`: accepted poses whose azimuth is
    off by more degrees."""

    trials: int
    accepted: int
    angles: tuple[Spread, Spread, Spread]
    traced: Spread
    traced_before: Spread
    focal_percent: Spread
    z: Angles
    wrong_by_1: int
    wrong_by_2: int
    verdicts: dict[str, int]
    seconds: Spread

    @classmethod
    def of(cls, trials: Sequence[PoseTrial]) -> "PoseScore":
        taken = [trial for trial in trials if trial.accepted]
        errors = np.array([trial.after for trial in taken]).reshape(-1, 3)
        words = [trial.verdict for trial in trials]
        return cls(
            len(trials),
            len(taken),
            (Spread.of(errors[:, 0]), Spread.of(errors[:, 1]), Spread.of(errors[:, 2])),
            Spread.of([trial.traced for trial in taken]),
            Spread.of([trial.traced_before for trial in taken]),
            Spread.of([100 * (trial.focal - 1) for trial in taken]),
            typical_z([trial.z for trial in taken]),
            int((np.abs(errors[:, 0]) > 1).sum()),
            int((np.abs(errors[:, 0]) > 2).sum()),
            {word: words.count(word) for word in dict.fromkeys(words)},
            Spread.of([trial.seconds for trial in trials]),
        )

    @classmethod
    def by_view(cls, trials: Sequence[PoseTrial]) -> "dict[str, PoseScore]":
        """Return the scores by how much of the horizon is open, and by sensor."""
        scores = {}
        for place in ("inside", "open", "between"):
            for sensor in dict.fromkeys(trial.sensor for trial in trials):
                some = [t for t in trials if t.sensor is sensor and _place_of(t) == place]
                if some:
                    scores[f"{place}, {sensor}"] = cls.of(some)
        return scores


def typical_z(z: Sequence[Sequence[float]]) -> Angles:
    """Return 1.48 median |z| of each angle; NaN of none."""
    return three(1.4826 * np.median(np.abs(np.array(z)), axis=0)) if z else (math.nan, math.nan, math.nan)


def _place_of(trial: PoseTrial) -> str:
    if trial.open_share <= INSIDE:
        return "inside"
    return "open" if trial.open_share >= OPEN else "between"
