"""The frames of a recording that carry truth, as core types."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ltm_core.evaluation.truth_frames_io import TruthFrame
from ltm_core.site import Site
from ltm_msgs_py.camera_info import msg_to_camera
from ltm_msgs_py.image import compressed_to_rgb, msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose
from ltm_ros.recordings.frame_stream import FrameStream, Parts
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    DEPTH_CAMERA_INFO,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    POSE,
    POSED_POSE,
    TRUTH_DEPTH,
    TRUTH_GROUND_DEPTH,
    TRUTH_LABELS,
)

_PARTS: Parts = {
    "camera": ((CAMERA_INFO, msg_to_camera), (DEPTH_CAMERA_INFO, msg_to_camera)),
    "pose": ((POSE, msg_to_pose), (POSED_POSE, msg_to_pose)),
    "photo": ((IMAGE_COMPRESSED, compressed_to_rgb), (IMAGE_RAW, msg_to_rgb)),
    "surface": ((TRUTH_DEPTH, msg_to_depth),),
    "ground": ((TRUTH_GROUND_DEPTH, msg_to_depth),),
    "labels": ((TRUTH_LABELS, lambda m: msg_to_array(m, ("mono8",))),),
}


def recorded_truth_frames(bag: Path, site: Site) -> Iterator[TruthFrame]:
    """The frames of a bag that have photo, calibration, pose and truth. Raises RecordingError, ImageError."""
    for frame in FrameStream(bag, site.name, list(site.cameras), _PARTS).frames(list(_PARTS)):
        surface = frame.take("surface")
        yield TruthFrame(
            frame.camera_name,
            frame.stamp_ns,
            frame.take("camera"),
            frame.take("pose"),
            frame.take("photo"),
            surface,
            frame.take("ground"),
            frame.take("labels"),
            np.zeros(surface.shape, np.bool_),
        )
