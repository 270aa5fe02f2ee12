"""Eyes of rendered frames as mounted cameras: what node `pose` makes of their pictures before and after a turn."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.pose_covariance import pose_covariance
from ltm_core.pose_estimation.mount.mount_config import PoseRefinementConfig
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_core.pose_estimation.mount.mount_watch import MountState, MountWatch
from ltm_core.pose_estimation.mount.skyline_turns import SkylineTurns
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_lab.evaluation.locating.smoke_score import TURNED_DEG
from ltm_lab.evaluation.locating.smoke_trials import PoseErrors
from ltm_lab.evaluation.pose.pose_trial import PreparedFrame

BEFORE = 12
"""Pictures that are shown before the turn: as many as a mount is found in at most."""
AFTER = (0, 1, 3, 10)
"""Pictures after it."""
SIDES = (-1, 0, 1)
"""By how many turns of TURNED_DEG a stated azimuth is then too great."""
SECOND_NS = 1_000_000_000
EVERY_NS = round(PoseRefinementConfig().every * SECOND_NS)
"""Between two pictures."""


@dataclass(frozen=True, eq=False)
class Shown:
    """`turns`: of the clear pictures, what each says of the camera's turn; oldest first. `noticed`: whether the node
    has said, since the turn, that the camera looks elsewhere.
    """

    turns: tuple[SkylineTurns, ...]
    noticed: bool


@dataclass(frozen=True, eq=False)
class WatchedEye:
    """A camera at an eye. `offsets`: (6,) sigmas by which its pose is stated wrong. `correction`: before the turn;
    `held`: whether pictures had found it. `shown`: by side and number of pictures since.
    """

    name: str
    position: Float64Array
    offsets: Float64Array
    correction: PoseCorrection
    held: bool
    shown: dict[tuple[int, int], Shown]


def stated_pose(true: Pose, offsets: Float64Array, errors: PoseErrors, turned_deg: float) -> tuple[Pose, Float64Array]:
    """A pose as its camera states it, with its covariance (6, 6): wrong by `errors`, and turned besides."""
    azimuth, pitch, roll = true.angles_deg
    a = errors.angle_deg
    stated = Pose.from_angles(
        true.position, azimuth + a * offsets[3] + turned_deg, pitch + a * offsets[4], roll + a * offsets[5]
    )
    return stated, pose_covariance(stated, 0.0, 0.0, a, a, a)


def watched_eye(
    name: str,
    frames: Sequence[PreparedFrame],
    terrain: SearchTerrain,
    errors: PoseErrors,
    rng: np.random.Generator,
    picture_config: PicturePoseConfig,
) -> WatchedEye:
    """Show an eye's frames in turn, BEFORE of them as they should be, then as each of SIDES has them.

    Args:
        frames: of one direction or of several, as of a fixed camera or a head.
    """
    offsets = rng.standard_normal(6)
    watch = MountWatch(terrain, PoseRefinementConfig(), picture_config)
    turns: list[SkylineTurns] = []
    for number in range(BEFORE):
        _show(watch, frames[number % len(frames)], offsets, errors, 0.0, number * EVERY_NS, turns)
    correction, held = watch.correction, watch.state is MountState.HELD
    begin, first = BEFORE * EVERY_NS, int(rng.integers(len(frames)))
    shown: dict[tuple[int, int], Shown] = {}
    for side in SIDES:
        after, since, noticed = copy.deepcopy(watch, {id(terrain): terrain}), list(turns), False
        for number in range(max(AFTER) + 1):
            if number in AFTER:
                shown[side, number] = Shown(tuple(since), noticed)
            if noticed:
                continue  # it is named from now on
            frame = frames[(first + number) % len(frames)]
            _show(after, frame, offsets, errors, side * TURNED_DEG, begin + number * EVERY_NS, since)
            noticed = not after.correction.known
    return WatchedEye(name, frames[0].frame.pose.position, offsets, correction, held, shown)


def _show(
    watch: MountWatch,
    frame: PreparedFrame,
    offsets: Float64Array,
    errors: PoseErrors,
    turned_deg: float,
    stamp_ns: int,
    turns: list[SkylineTurns],
) -> None:
    """As the node `pose` does: what was said from another correction is forgotten."""
    pose, covariance = stated_pose(frame.frame.pose, offsets, errors, turned_deg)
    before = watch.correction
    watch.look(frame.evidence, pose, covariance)
    if watch.correction is not before and watch.correction.known:
        turns.clear()
    said = watch.turns(frame.evidence, stamp_ns, pose, covariance)
    if said is not None:
        turns.append(said)
