"""By how much the poses of a recording are off those of another of the same frames, such as one with true poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.pose_covariance import pose_sigmas
from ltm_core.site.site import Site
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_ros.recordings.frame_stream import FrameStream
from ltm_ros.runtime.topics import POSE

PARTS = ("east, m", "north, m", "up, m", "azimuth, deg", "pitch, deg", "roll, deg")


@dataclass(frozen=True, eq=False)
class RecordedPoseErrors:
    """`errors`: (N, 6) told minus true, metres and degrees in the order of PARTS. `sigmas`: (N, 6) that the recording
    states, NaN where it states none; of azimuth, pitch and roll about their own axes. `unmatched`: frames without a
    true pose of their stamp."""

    errors: Float64Array
    sigmas: Float64Array
    unmatched: int

    @property
    def azimuth_deg(self) -> tuple[float, float]:
        """Median and largest of the absolute errors."""
        off = np.abs(self.errors[:, 3])
        return float(np.median(off)), float(off.max())


def recorded_pose_errors(bag: Path, true: Path, site: Site) -> RecordedPoseErrors:
    """Of all cameras, joined by camera and stamp. Raises RecordingError where no frame has a true pose."""
    told, truth = recorded_poses(bag, site), recorded_poses(true, site)
    errors, sigmas = [], []
    for key in sorted(told.keys() & truth.keys()):
        pose, covariance = told[key]
        other, _ = truth[key]
        turns = (np.subtract(pose.angles_deg, other.angles_deg) + 180) % 360 - 180
        errors.append([*(pose.position - other.position), *turns])
        sigmas.append(np.full(6, np.nan) if covariance is None else pose_sigmas(pose, covariance))
    if not errors:
        raise RecordingError(
            f"{bag} and {true} have no frame of one stamp in common ({len(told)} and {len(truth)} poses of the cameras "
            f"{', '.join(site.cameras)}): import both from the same photos"
        )
    return RecordedPoseErrors(np.array(errors), np.array(sigmas), len(told) - len(errors))


def recorded_poses(bag: Path, site: Site) -> dict[tuple[str, int], tuple[Pose, Float64Array | None]]:
    """Of all cameras by camera and stamp: the pose in the map frame, and the covariance (6, 6) that it states."""
    stream = FrameStream.open(bag, site, {"pose": ((POSE, _stated),)})
    return {(frame.camera_name, frame.stamp_ns): frame.take("pose") for frame in stream.frames()}


def _stated(message: Any) -> tuple[Pose, Float64Array | None]:
    return msg_to_pose(message, "map"), msg_to_covariance(message)
