"""Converts the frames of `ltm-lab simulate` to a recording for the graph, with truth on topics of its own."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.base.types import Float32Array
from ltm_lab.frames.truth_frames_io import TruthFrame, read_index, read_truth_frames
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, depth_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    IMAGE_COMPRESSED,
    POSE,
    TRUTH_CAMERA_INFO,
    TRUTH_DEPTH,
    TRUTH_GROUND_DEPTH,
    TRUTH_LABELS,
    TRUTH_POSE,
    camera_topic,
)


def write_simulated_bag(
    frames: Path,
    out: Path,
    site: str,
    quality: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    date: str | None = None,
) -> int:
    """Write the frames of a `ltm-lab simulate` folder, of `date` alone if given, as a bag of site `site`; the number of
    frames.

    `quality`: JPEG quality of the images, the scenario's unless given. Truth depth is along the optical axis (REP-118),
    of every n-th pixel as the scenario says and rounded to 6e-5 of itself, with a camera_info of its own; `pose` is
    what the sensors reported, with its covariance, `truth/pose` where it was. Messages lie in the order in which they
    came. Raises RecordingError on a folder without frames.json."""
    index = read_index(frames)
    quality = index.jpeg_quality if quality is None else quality
    waiting = sorted(read_truth_frames(frames, date or ""), key=lambda f: (f.reported.received_ns, f.camera_name))
    total = len(waiting)
    waiting.reverse()
    writer = BagWriter(out)
    try:
        with writer as bag:
            while waiting:
                _write_frame(bag, waiting.pop(), site, index.truth_step, quality)
                progress(total - len(waiting), total)
    except LtmError:
        shutil.rmtree(out, ignore_errors=True)  # half a recording looks like a whole one
        raise
    return total


def _write_frame(bag: BagWriter, frame: TruthFrame, site: str, step: int, quality: int) -> None:
    told, optical = frame.reported, f"{frame.camera_name}_optical"
    stamp = told.stamp_ns
    jpeg = encode_rgb(frame.photo, "jpeg", quality)

    def write(topic: Topic, message: Any) -> None:
        bag.write(camera_topic(site, frame.camera_name, topic), message, told.received_ns)

    write(CAMERA_INFO, camera_to_msg(frame.camera, stamp, optical))
    write(POSE, pose_to_msg(told.pose, stamp, covariance=np.diag(told.covariance)))
    write(IMAGE_COMPRESSED, compressed_to_msg(jpeg, "jpeg", stamp, optical))
    write(TRUTH_POSE, pose_to_msg(frame.pose, stamp))
    write(TRUTH_CAMERA_INFO, camera_to_msg(frame.camera.scaled(step), stamp, optical))
    write(TRUTH_DEPTH, depth_to_msg(_rounded(frame.surface), stamp, optical))
    write(TRUTH_GROUND_DEPTH, depth_to_msg(_rounded(frame.ground), stamp, optical))
    write(TRUTH_LABELS, image_to_msg(frame.labels, "mono8", stamp, optical))


def _rounded(depth: Float32Array) -> Float32Array:
    """Depth to 13 bits of mantissa, 6e-5 of itself: far below what it scores, and a third smaller when compressed."""
    bits = depth.view(np.uint32)
    rounded = ((bits + 0x200) & ~np.uint32(0x3FF)).view(np.float32)
    return np.where(np.isfinite(depth), rounded, depth)
