"""Trials of mounts: presets of one PTZ head that are fitted together, and the live watch of a camera that is turned."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.pose_estimation.mount.mount_config import PoseRefinementConfig
from ltm_core.pose_estimation.mount.mount_fit import TILT_ZERO_SIGMA_DEG, fit_mount, widened
from ltm_core.pose_estimation.mount.mount_watch import MountState, MountWatch
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain, find_pose
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between, turned
from ltm_lab.evaluation.pose.pose_trial import Angles, PoseJob, PoseTrial, run_pose_trials, sigmas_deg, three
from ltm_lab.evaluation.pose.rendered_terrain_io import PreparedFrame, RenderedSite, by_camera

_ENCODER_DEG = 0.03
_ROUNDS = 2
"""Times that a watched camera shows each of its directions, before it is turned and after."""


@dataclass(frozen=True)
class MountTrial:
    """One PTZ head. Of each image the errors of the angles, degrees, and these over their sigmas (`z`); `focal`: found
    focal length over the true one."""

    head: str
    verdict: str
    errors: tuple[Angles, ...]
    z: tuple[Angles, ...]
    focal: float = 1.0


@dataclass(frozen=True)
class WatchTrial:
    """One camera that shows all its directions in turn, first with exact poses, then turned.

    `pictures`, `clear`: images shown, and those with enough evidence. `held`: the mount was found. `alarms`: times that
    it was said to have slipped, or to contradict its poses. `error`: largest errors of the corrected angles before the
    turn, degrees. `noticed`: clear images until the turn was reported; None if it was not. `refitted`: the mount was
    found again; `error_after`: the errors then. `tracked_seconds`: processor time of each image of a held mount."""

    camera: str
    pictures: int
    clear: int
    held: bool
    alarms: int
    error: Angles
    noticed: int | None
    refitted: bool
    error_after: Angles
    tracked_seconds: tuple[float, ...]


@dataclass(frozen=True)
class WatchJob:
    """A rendered site, the sigma that is stated of each angle, and the turn of the cameras, degrees."""

    site: RenderedSite
    sigma_deg: float
    turn_deg: float


def run_pose_job(job: PoseJob) -> list[PoseTrial | MountTrial]:
    """Run the trials of single poses of a site, and of its PTZ heads if they are asked for."""
    terrain = job.site.terrain()
    frames = job.site.frames(terrain)
    trials: list[PoseTrial | MountTrial] = [*run_pose_trials(job, terrain, frames)]
    for head, presets in by_camera(frames).items() if job.mounts else ():
        rng = job.rng(977, *head.encode())
        factor = job.focal_factor(rng)
        trial = run_mount_trial(presets, terrain, rng, factor, 0.5 * job.focal)
        trials.append(replace(trial, head=f"{job.site.folder.name}/{head}"))
    return trials


def run_mount_trial(
    frames: Sequence[PreparedFrame],
    terrain: SearchTerrain,
    rng: np.random.Generator,
    focal_factor: float = 1.0,
    focal_sigma: float = 0.0,
) -> MountTrial:
    """Lean and turn the mount of a PTZ head (1.5 deg of yaw, 0.5 of lean), move its tilt zero (0.3) and its encoder
    (0.03) for every image, and fit the mount to all images; the focal length too if it is off by a factor."""
    lean = np.radians(rng.normal(size=3) * (0.5, 0.5, 1.5))
    tilt = np.radians(TILT_ZERO_SIGMA_DEG * rng.normal())
    up = Rotation.from_rotvec([tilt, 0.0, 0.0]).as_matrix()
    priors, searches = [], []
    for prepared in frames:
        noise = np.radians(_ENCODER_DEG * rng.normal(size=3))
        true, evidence = prepared.frame.pose, prepared.evidence
        prior = PosePrior(turned(turned(Pose(true.position, true.rotation @ up), lean), noise), 1.5, 0.5, 0.5)
        priors.append(prior)
        if focal_factor != 1.0:
            evidence = replace(evidence, camera=evidence.camera.zoomed(focal_factor))
        searches.append(find_pose(evidence, terrain, widened(prior, TILT_ZERO_SIGMA_DEG), focal_sigma))
    fit = fit_mount(priors, searches, focal_sigma=focal_sigma)
    errors = [np.degrees(angles_between(p.frame.pose, found)) for p, found in zip(frames, fit.found, strict=True)]
    z = [error / sigmas_deg(fit.found[k], fit.pose_covariance(k)) for k, error in enumerate(errors)]
    return MountTrial("", fit.word, tuple(map(three, errors)), tuple(map(three, z)), focal_factor * fit.focal)


def run_watch_job(job: WatchJob) -> list[WatchTrial]:
    """Run the watch of all cameras of a site."""
    terrain = job.site.terrain()
    return [
        run_watch_trial(f"{job.site.folder.name}/{camera}", frames, terrain, job)
        for camera, frames in by_camera(job.site.frames(terrain)).items()
    ]


def run_watch_trial(camera: str, frames: Sequence[PreparedFrame], terrain: SearchTerrain, job: WatchJob) -> WatchTrial:
    """Show a camera's images with their true poses, then as if it had been turned without notice: the stated poses are
    off by the turn."""
    watch = MountWatch(terrain, PoseRefinementConfig())
    turn, sigma = np.radians([0.0, 0.0, job.turn_deg]), job.sigma_deg

    def shown(by: Float64Array) -> Iterator[tuple[bool, MountState, float]]:
        """Show all images in turn; yield whether it was clear, the state before, and the processor time."""
        for frame in [*frames] * _ROUNDS:
            before, begin = watch.state, time.process_time()
            stated = _turned(frame.frame.pose, by)
            covariance = pose_covariance(stated, 0.0, 0.0, sigma, sigma, sigma)
            clear = watch.look(frame.unseen, stated, covariance)
            yield clear, before, time.process_time() - begin + frame.seconds

    clear = alarms = 0
    tracked = []
    for was_clear, before, seconds in shown(np.zeros(3)):
        clear += was_clear
        alarms += watch.state is not before and watch.state in (MountState.SLIPPED, MountState.CONTRADICTED)
        if before is MountState.HELD:
            tracked.append(seconds)
    held, error = watch.state is MountState.HELD, _largest_error(watch, frames, np.zeros(3))
    noticed, refitted, error_after = None, False, error
    if held:
        looked = 0
        for was_clear, _, _ in shown(turn):
            looked += was_clear
            if noticed is None and watch.state is not MountState.HELD:
                noticed = looked
            elif noticed is not None and watch.state is MountState.HELD:
                refitted = True
                break
        error_after = _largest_error(watch, frames, turn)
    count = _ROUNDS * len(frames)
    return WatchTrial(camera, count, clear, held, alarms, error, noticed, refitted, error_after, tuple(tracked))


def _largest_error(watch: MountWatch, frames: Sequence[PreparedFrame], turn: Float64Array) -> Angles:
    """Return the largest error of each angle over the directions, degrees."""
    errors = []
    for frame in frames:
        corrected, _ = watch.correction.applied(_turned(frame.frame.pose, turn), np.eye(6))
        errors.append(np.abs(np.degrees(angles_between(frame.frame.pose, corrected))))
    return three(np.max(errors, axis=0))


def _turned(pose: Pose, by: Float64Array) -> Pose:
    return turned(pose, by) if by.any() else pose
