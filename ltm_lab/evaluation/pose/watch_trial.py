"""The live watch of a mount on rendered pictures: exact poses must raise no alarm, a turn must be noticed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.pose_covariance import pose_covariance
from ltm_core.pose_estimation.mount.mount_config import PoseRefinementConfig
from ltm_core.pose_estimation.mount.mount_watch import MountState, MountWatch
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_prior import angles_between, turned
from ltm_lab.evaluation.pose.pose_trial import PreparedFrame

_ROUNDS = 2
"""How often a camera comes by each of its directions before it is turned, and after."""


@dataclass(frozen=True)
class WatchTrial:
    """Of one camera that is shown all its directions in turn, first with exact poses.

    `pictures`, `clear`: shown, and those that told something. `held`: whether the mount was found. `alarms`: how often
    it was said to have slipped, or to contradict its poses. `error`: (3,) degrees of azimuth, pitch and roll by which
    the correction then was off. `noticed`: clear pictures until it was said that the camera had been turned; None: not
    within the rounds, or never held. `refitted`: whether it was found again, and `error_after` by how much it was off.
    `tracked_seconds`: of CPU, for each picture of a mount that was held, its preparation with it.
    """

    camera: str
    pictures: int
    clear: int
    held: bool
    alarms: int
    error: tuple[float, float, float]
    noticed: int | None
    refitted: bool
    error_after: tuple[float, float, float]
    tracked_seconds: tuple[float, ...]


def run_watch_trial(
    camera: str,
    frames: Sequence[PreparedFrame],
    terrain: SearchTerrain,
    picture_config: PicturePoseConfig,
    sigma_deg: float,
    turn_deg: float,
    config: PoseRefinementConfig = PoseRefinementConfig(),
) -> WatchTrial:
    """Show a camera's pictures with their true poses, `sigma_deg` of each angle stated; then as if the camera had been
    turned by `turn_deg` of azimuth without anybody's knowledge: the stated poses lie beside the true ones by that.
    """
    watch = MountWatch(terrain, config, picture_config)
    clear, tracked = 0, []
    order = [frame for _ in range(_ROUNDS) for frame in frames]
    alarms = 0
    for frame in order:
        held, before = watch.state is MountState.HELD, watch.state
        begin = time.process_time()
        clear += _shown(watch, frame, frame.frame.pose, sigma_deg)
        if held:
            tracked.append(time.process_time() - begin + frame.seconds)
        alarms += watch.state is not before and watch.state in (MountState.SLIPPED, MountState.CONTRADICTED)
    held, error = watch.state is MountState.HELD, _error(watch, frames, None)
    noticed, refitted, error_after = None, False, error
    if held:
        turn = np.radians([0.0, 0.0, turn_deg])
        looked = 0
        for frame in order:
            looked += _shown(watch, frame, turned(frame.frame.pose, turn), sigma_deg)
            if noticed is None and watch.state is not MountState.HELD:
                noticed = looked
            elif noticed is not None and watch.state is MountState.HELD:
                refitted = True
                break
        error_after = _error(watch, frames, turn)
    return WatchTrial(camera, len(order), clear, held, alarms, error, noticed, refitted, error_after, tuple(tracked))


def _shown(watch: MountWatch, frame: PreparedFrame, stated: Pose, sigma_deg: float) -> bool:
    fresh = frame.evidence.unseen  # a picture that has just come
    return watch.look(fresh, stated, pose_covariance(stated, 0.0, 0.0, sigma_deg, sigma_deg, sigma_deg))


def _error(watch: MountWatch, frames: Sequence[PreparedFrame], turn: Float64Array | None) -> tuple[float, float, float]:
    """The largest over the directions, of each angle."""
    worst = np.zeros(3)
    for frame in frames:
        true = frame.frame.pose
        corrected, _ = watch.correction.applied(true if turn is None else turned(true, turn), np.eye(6))
        worst = np.maximum(worst, np.abs(np.degrees(angles_between(true, corrected))))
    azimuth, pitch, roll = (float(v) for v in worst)
    return azimuth, pitch, roll
