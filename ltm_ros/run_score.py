"""Scores a recorded run against the truth that a simulated recording carries."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ltm_core.camera import Camera
from ltm_core.errors import RecordingError
from ltm_core.metrics.depth import DepthScore
from ltm_core.metrics.depth_tally import DepthTally
from ltm_core.metrics.segmentation import SegmentationScore
from ltm_core.pose import Pose
from ltm_core.site import Site
from ltm_msgs_py.camera_info import msg_to_camera
from ltm_msgs_py.image import compressed_to_rgb, msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose
from ltm_ros.frame_stream import FrameStream, Parts
from ltm_ros.topics import (
    DEPTH_CAMERA_INFO,
    DEPTH_IMAGE,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    LABELS_IMAGE,
    POSED_POSE,
    TRUTH_CAMERA_INFO,
    TRUTH_DEPTH,
    TRUTH_GROUND_DEPTH,
    TRUTH_LABELS,
)


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """One frame of a run: what went in and what came out, as arrays."""

    camera_name: str
    stamp_ns: int
    camera: Camera
    pose: Pose
    photo: NDArray[np.uint8]
    depth: NDArray[np.float32]
    labels: NDArray[np.uint8]
    truth_camera: Camera | None = None
    truth_depth: NDArray[np.float32] | None = None
    truth_ground_depth: NDArray[np.float32] | None = None
    truth_labels: NDArray[np.uint8] | None = None

    @property
    def truth_step(self) -> int:
        """Every how many pixels truth is given. Raises RecordingError where it fits no step."""
        if self.truth_camera is None:
            raise RecordingError(f"frame {self.stamp_ns} of {self.camera_name} has no truth")
        step = round(self.camera.width / self.truth_camera.width)
        if self.camera.scaled(step) != self.truth_camera:
            raise RecordingError(f"truth of {self.camera_name} is of {self.truth_camera}, no step of {self.camera}")
        return step


@dataclass(frozen=True, eq=False)
class RunScore:
    """Depth against the visible surface and against bare ground; labels against truth."""

    frames: int
    surface: list[DepthScore]
    ground: list[DepthScore]
    labels: SegmentationScore


_LABELS = ("mono8",)
_PARTS: Parts = {
    "camera": ((DEPTH_CAMERA_INFO, msg_to_camera),),
    "pose": ((POSED_POSE, msg_to_pose),),
    "photo": ((IMAGE_COMPRESSED, compressed_to_rgb), (IMAGE_RAW, msg_to_rgb)),
    "depth": ((DEPTH_IMAGE, msg_to_depth),),
    "labels": ((LABELS_IMAGE, lambda m: msg_to_array(m, _LABELS)),),
    "truth_camera": ((TRUTH_CAMERA_INFO, msg_to_camera),),
    "truth_depth": ((TRUTH_DEPTH, msg_to_depth),),
    "truth_ground_depth": ((TRUTH_GROUND_DEPTH, msg_to_depth),),
    "truth_labels": ((TRUTH_LABELS, lambda m: msg_to_array(m, _LABELS)),),
}
_NEEDED = ("camera", "pose", "photo", "depth", "labels")


def recorded_frames(bag: Path, site: Site) -> Iterator[RecordedFrame]:
    """The frames of a recorded run that came out with depth and labels, one camera after the other, in time order.

    A frame is handed out as soon as the bag has given all of it, so a bag of hours needs the memory of a few frames.
    """
    stream = FrameStream(bag, site.name, list(site.cameras), _PARTS)
    for camera in site.cameras:
        for frame in stream.frames(_NEEDED, [camera]):
            parts = {part: frame.take(part) for part in _PARTS}
            yield RecordedFrame(camera, frame.stamp_ns, **parts)


def score_run(bag: Path, site: Site, classes: int) -> RunScore:
    """Scores over all frames that carry truth. Raises RecordingError where none does."""
    surface, ground = DepthTally(), DepthTally()
    labels, count = SegmentationScore.empty(classes), 0
    for frame in recorded_frames(bag, site):
        if frame.truth_depth is None or frame.truth_ground_depth is None or frame.truth_labels is None:
            continue
        step = frame.truth_step
        surface.add(frame.depth[::step, ::step], frame.truth_depth)
        ground.add(frame.depth[::step, ::step], frame.truth_ground_depth)
        labels = labels.plus(frame.truth_labels, frame.labels[::step, ::step])
        count += 1
    if count == 0:
        raise RecordingError(f"{bag} holds no frame with depth, labels and truth: nothing can be scored")
    return RunScore(count, surface.scores(), ground.scores(), labels)
