"""Converts the frames of `ltm-lab simulate` to a recording for the graph, with truth on topics of its own."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import cv2
import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float32Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.camera_info import camera_to_msg
from ltm_msgs_py.image import compressed_to_msg, depth_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
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
    what the sensors reported, with its covariance, `truth/pose` where it was. Messages lie in the order in which
    they came. Raises RecordingError on a folder without frames.json.
    """
    index_file = frames / "frames.json"
    try:
        index = json.loads(index_file.read_text(encoding="utf-8"))
        entries, step = index["frames"], int(index["truth_step"])
        quality = int(index.get("jpeg_quality", 78)) if quality is None else quality
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordingError(
            f"{index_file}: no index of simulated frames ({error}); `ltm-lab simulate` writes one"
        ) from error
    entries = [e for e in entries if date is None or e.get("date") == date]
    entries.sort(key=lambda e: (e.get("reported", e).get("received_ns", e["stamp_ns"]), e["camera_name"]))
    writer = BagWriter(out)
    try:
        with writer as bag:
            for done, entry in enumerate(entries, start=1):
                _write_frame(bag, frames, entry, site, step, quality)
                progress(done, len(entries))
    except RecordingError:
        shutil.rmtree(out, ignore_errors=True)  # half a recording looks like a whole one
        raise
    return len(entries)


def _write_frame(bag: BagWriter, folder: Path, entry: dict[str, Any], site: str, step: int, quality: int) -> None:
    name, told = entry["camera_name"], entry.get("reported", entry)
    stamp, received = int(told["stamp_ns"]), int(told.get("received_ns", told["stamp_ns"]))
    optical = f"{name}_optical"
    camera = Camera(**entry["camera"] | {"distortion": tuple(entry["camera"]["distortion"])})
    pose = Pose.from_angles(entry["position"], entry["azimuth_deg"], entry["pitch_deg"], entry["roll_deg"])
    told_pose = Pose.from_angles(told["position"], told["azimuth_deg"], told["pitch_deg"], told["roll_deg"])
    covariance = np.diag(told.get("covariance", np.zeros(6)))
    image = cv2.imread(str(folder / entry["image"]), cv2.IMREAD_COLOR)
    if image is None:
        raise RecordingError(f"{folder / entry['image']}: the frame's picture is missing or broken; render it again")
    jpeg = encode_rgb(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8), "jpeg", quality)
    sampled = camera.scaled(step)
    try:
        with np.load(folder / entry["truth"]) as truth:
            surface = _rounded(RangeImage(truth["range_surface"].astype(np.float32), sampled, pose).depth())
            ground = _rounded(RangeImage(truth["range_ground"].astype(np.float32), sampled, pose).depth())
            labels = truth["labels"].astype(np.uint8)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise RecordingError(f"{folder / entry['truth']}: no truth of the frame ({error}); render it again") from error

    def write(topic: Topic, message: Any) -> None:
        bag.write(camera_topic(site, name, topic), message, received)

    write(CAMERA_INFO, camera_to_msg(camera, stamp, optical))
    write(POSE, pose_to_msg(told_pose, stamp, covariance=covariance))
    write(IMAGE_COMPRESSED, compressed_to_msg(jpeg, "jpeg", stamp, optical))
    write(TRUTH_POSE, pose_to_msg(pose, stamp))
    write(TRUTH_CAMERA_INFO, camera_to_msg(sampled, stamp, optical))
    write(TRUTH_DEPTH, depth_to_msg(surface, stamp, optical))
    write(TRUTH_GROUND_DEPTH, depth_to_msg(ground, stamp, optical))
    write(TRUTH_LABELS, image_to_msg(labels, "mono8", stamp, optical))


def _rounded(depth: Float32Array) -> Float32Array:
    """Depth to 13 bits of mantissa, 6e-5 of itself: far below what it scores, and a third smaller when compressed."""
    bits = depth.view(np.uint32)
    rounded = ((bits + 0x200) & ~np.uint32(0x3FF)).view(np.float32)
    return np.where(np.isfinite(depth), rounded, depth)
