"""Maintain the pose of a mounted camera: correct the stated pose by its images, and detect slips.

The mount's error is found in several clear images together (`mount_fit`). From then on each clear image is laid on the
terrain from the corrected pose; if most of the last ones show another viewing direction, the mount is reported as
slipped, its poses are not used, and the error is estimated again."""

import math
from collections import deque
from dataclasses import replace
from enum import Enum

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import UNKNOWN_AZIMUTH_SIGMA_DEG, Pose, matrix_of_vector, vector_of_matrix
from ltm_core.pose_estimation.mount.mount_config import PoseRefinementConfig
from ltm_core.pose_estimation.mount.mount_fit import fit_ptz_mount
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_core.pose_estimation.skyline.contour_scores import ContourDirections, PictureEvidence
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, SearchTerrain, find_pose
from ltm_core.pose_estimation.skyline.image_edges import ImageSkyline
from ltm_core.pose_estimation.skyline.picture_pose_config import Criteria
from ltm_core.pose_estimation.skyline.pose_hypothesis import search_reach
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angle_slopes, angles_between
from ltm_core.pose_estimation.skyline.pose_refinement import ROUNDS, refine, skyline_fit
from ltm_core.pose_estimation.skyline.skyline_search import search_azimuths
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon

_KEPT = 16  # maximum number of horizons kept, as many as a PTZ head has presets
_STEP_DEG = 2.0  # difference in degrees below which two directions share a horizon
_TRACKING = (*ROUNDS[::2], ROUNDS[-1])  # rounds of the fit for an image of a known mount, near the solution
_TRACKED_SIGMA_DEG = 1.0  # sigma of each angle within which an image of a known mount may deviate
_TURN_STEP_DEG, _TURN_STEPS = 0.25, 8  # turns to either side of a known pose that the skyline is tested at
_TURN_NEAR = 2  # number of steps within which a fit from the known pose finds the turn itself
_TURN_GAIN = 2.0  # minimum difference of cost between a turned and the known pose


class MountState(Enum):
    STATED = "stated"  # poses are used as stated: too few clear images so far
    HELD = "held"  # poses are corrected, and images agree
    SLIPPED = "slipped"  # images show another viewing direction, which is not known yet
    CONTRADICTED = "contradicted"  # images agree with each other, but not with the stated pose and its sigmas


class MountWatch:
    """Monitor the mount of one camera by its images; give them in time order. `tilt_zero_sigma_deg`: standard deviation
    of the zero of a PTZ head's tilt axis; 0: none is estimated."""

    def __init__(self, terrain: SearchTerrain, config: PoseRefinementConfig, tilt_zero_sigma_deg: float = 0.0) -> None:
        self._tilt_zero_sigma_deg = tilt_zero_sigma_deg
        self._terrain, self._config = terrain, config
        self.correction = PoseCorrection(np.zeros(3), None)
        self.state = MountState.STATED
        self.reason = "too few clear images so far"
        """Reason for the state, in words."""
        self.slips = 0
        """Number of slips reported for the mount."""
        self._priors: list[PosePrior] = []
        self._searches: list[PictureSearch] = []
        self._contradictions: list[Float64Array] = []
        """Turns (rad) from the stated pose of clear images that show nothing near it."""
        self._tracked: deque[Float64Array | None] = deque(maxlen=config.judged)
        """Turn (rad) of each clear image of a known mount, where it exceeds the errors."""
        self._horizons: dict[tuple[object, ...], tuple[TerrainHorizon, ContourDirections]] = {}

    def look(self, evidence: PictureEvidence, stated: Pose, covariance: Float64Array) -> bool:
        """Process an image whose pose is stated with a covariance, (6, 6) as in `pose_covariance`; return whether it
        was clear. Raises PoseError for a camera beside the DEM or under its ground."""
        if self.state is MountState.HELD:
            return self._track(evidence, self.correction.applied(stated, covariance)[0])
        if self.state is MountState.SLIPPED:  # the place stays, whatever has turned the camera
            sigmas = (self._config.slip_sigma_deg,) * 3
            return self._gather(evidence, PosePrior(self.correction.applied(stated, covariance)[0], *sigmas))
        return self._gather(evidence, PosePrior.of_covariance(stated, covariance))

    def _gather(self, evidence: PictureEvidence, prior: PosePrior) -> bool:
        search = self._find(evidence, prior)
        if not search.hypotheses or search.verdict.word == "no_skyline":
            return False
        if evidence.skyline is not None and search.verdict.support < Criteria.clear_support:
            # What is stated as sure holds a search by force: does the image show another direction?
            return self._contradicts(evidence, prior)
        self._priors.append(prior)
        self._searches.append(search)
        if len(self._searches) >= self._config.gather:
            self._fit()
        return True

    def _contradicts(self, evidence: PictureEvidence, prior: PosePrior) -> bool:
        """Return whether an image is clear that shows nothing from near the stated pose."""
        sigma = self._config.slip_sigma_deg
        wide = replace(prior, azimuth_sigma_deg=sigma, pitch_sigma_deg=sigma, roll_sigma_deg=sigma)
        search = self._find(evidence, wide)
        if search.verdict.word != "accepted" or search.verdict.support < Criteria.clear_support:
            return False
        self._contradictions.append(angles_between(prior.pose, search.hypotheses[0].refined.pose))
        if len(self._contradictions) >= self._config.gather:
            reason = (
                f"{len(self._contradictions)} clear images show the terrain {_turn(self._contradictions, 1)} from the "
                "stated pose, which exceeds its sigmas: correct one of them"
            )
            self.become(MountState.CONTRADICTED, self._nowhere(), reason)
        return True

    def _fit(self) -> None:
        fit = fit_ptz_mount(self._priors, self._searches, self._tilt_zero_sigma_deg)
        before = self.correction
        if fit.word == "accepted":
            rotation, tilt_zero = fit.rotation, fit.tilt_zero
            if self.state is MountState.SLIPPED:  # its poses were those of the former correction
                rotation = vector_of_matrix(matrix_of_vector(fit.rotation) @ matrix_of_vector(before.rotation))
                tilt_zero += before.tilt_zero
            angles = np.asarray(fit.covariance[3:6, 3:6], np.float64)
            found = PoseCorrection(rotation, angles, tilt_zero, fit.covariance[6, 3:7])
            self.become(MountState.HELD, found, fit.reason)
        elif fit.word == "contradicts_prior":
            self.become(MountState.CONTRADICTED, self._nowhere(), fit.reason)
        elif len(self._searches) >= self._config.most_gathered:
            half = len(self._searches) // 2  # the others may show more, under another sky
            del self._priors[:half], self._searches[:half]

    def _nowhere(self) -> PoseCorrection:
        """Return the correction so far with unknown angles, with which nothing is located."""
        unknown = np.eye(3) * math.radians(UNKNOWN_AZIMUTH_SIGMA_DEG) ** 2
        return PoseCorrection(self.correction.rotation, unknown, self.correction.tilt_zero)

    def become(self, state: MountState, correction: PoseCorrection, reason: str) -> None:
        """Set the state, found by this monitor or by a previous one of the same mount."""
        self.state, self.correction, self.reason = state, correction, reason
        self._priors.clear()
        self._searches.clear()
        self._contradictions.clear()
        self._tracked.clear()

    def _track(self, evidence: PictureEvidence, pose: Pose) -> bool:
        if evidence.skyline is None:
            return False
        prior = PosePrior(pose, *(_TRACKED_SIGMA_DEG,) * 3)
        horizon, ridges = self._horizon(evidence, prior)
        problem = PoseProblem(evidence, horizon, prior)
        around = ridges.in_view(pose, evidence.camera)
        turn = clearer_turn(evidence.skyline, evidence.camera, prior, horizon)
        starts = [pose] if turn is None else [pose, turn]
        begun = [refine(start, evidence.camera, problem, around, _TRACKING) for start in starts]
        found = min(begun, key=lambda refined: refined.cost)
        here = skyline_fit(pose, evidence.camera, problem).support
        least = Criteria.clear_support
        if max(here, found.skyline.support) < least:
            # Far off, or fog: only a search of its own tells.
            search = self._find(evidence, PosePrior(pose, *(self._config.slip_sigma_deg,) * 3))
            if search.verdict.word != "accepted":
                return False
            found = search.hypotheses[0].refined
        off = angles_between(pose, found.pose)
        slopes = angle_slopes(found.pose)
        sigmas = np.sqrt(np.diag(slopes @ (found.covariance[3:6, 3:6] + self.correction.angles_at(pose)) @ slopes.T))
        limits = math.radians(self._config.least_slip_deg) + self._config.slip_sigmas * sigmas
        self._tracked.append(off if (np.abs(off) > limits).any() else None)
        elsewhere = [turn for turn in self._tracked if turn is not None]
        if len(elsewhere) >= self._config.slipped:
            self.slips += 1
            reason = (
                f"{len(elsewhere)} of the last {len(self._tracked)} clear images show that the camera has turned by "
                f"{_turn(elsewhere, 2)}"
            )
            self.become(MountState.SLIPPED, self._nowhere(), reason)
        return True

    def _find(self, evidence: PictureEvidence, prior: PosePrior) -> PictureSearch:
        return find_pose(evidence, self._terrain, prior, horizon=self._horizon(evidence, prior)[0])

    def _horizon(self, evidence: PictureEvidence, prior: PosePrior) -> tuple[TerrainHorizon, ContourDirections]:
        """About the prior direction, of the last few that were asked for, with its ridges."""
        azimuth = round(prior.pose.angles_deg[0] / _STEP_DEG) * _STEP_DEG
        place = tuple(round(float(v), 2) for v in prior.pose.position)
        reach = search_reach(prior)
        key = (*place, azimuth, round(reach, 3), evidence.camera.fx, evidence.camera.width)
        if key not in self._horizons:
            middle = Pose.from_angles(prior.pose.position, azimuth, 0.0)
            around = replace(prior, pose=middle, azimuth_sigma_deg=prior.azimuth_sigma_deg + _STEP_DEG)
            horizon = self._terrain.horizon_for(evidence.camera, around)
            self._horizons[key] = horizon, ContourDirections.of(horizon)
            if len(self._horizons) > _KEPT:
                del self._horizons[next(iter(self._horizons))]
        return self._horizons[key]


def _turn(turns: list[Float64Array], digits: int) -> str:
    """Return the median of turns (rad) in words."""
    angles = ", ".join(f"{angle:+.{digits}f}" for angle in np.degrees(np.median(turns, axis=0)))
    return f"{angles} deg in azimuth, pitch and roll"


def clearer_turn(skyline: ImageSkyline, camera: Camera, known: PosePrior, horizon: TerrainHorizon) -> Pose | None:
    """Return the turned pose that fits the skyline clearly better than the known one, if any; a fit ends too near."""
    azimuth, pitch, roll = known.pose.angles_deg
    turns = math.radians(_TURN_STEP_DEG) * np.arange(-_TURN_STEPS, _TURN_STEPS + 1)
    azimuths = np.asarray(math.radians(azimuth) + turns, np.float64)
    cost, *tilts = search_azimuths(skyline, camera, known, horizon, azimuths, 0.0)
    best = int(np.argmin(cost))
    if abs(best - _TURN_STEPS) < _TURN_NEAR or cost[best] > cost[_TURN_STEPS] - _TURN_GAIN:
        return None
    turned, up, over = (math.degrees(float(change[best])) for change in (azimuths, *tilts))
    return Pose.from_angles(known.pose.position, turned, pitch + up, roll + over)
