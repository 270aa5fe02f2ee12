"""The frames of a recorded run: what went in and what came out, as arrays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.site import Site
from ltm_core.types import Float32Array, UInt8Array
from ltm_msgs_py.camera_info import msg_to_camera
from ltm_msgs_py.image import compressed_to_rgb, msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose
from ltm_ros.recordings.frame_stream import FrameStream, Parts
from ltm_ros.runtime.topics import (
    DEPTH_CAMERA_INFO,
    DEPTH_IMAGE,
    FUSED_DEPTH,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    LABELS_IMAGE,
    POSED_POSE,
)


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """`photo` (H, W, 3), `depth` traced and `labels`, (H, W) each; `fused` depth where the site has a depth network."""

    camera_name: str
    stamp_ns: int
    camera: Camera
    pose: Pose
    photo: UInt8Array
    depth: Float32Array
    labels: UInt8Array
    fused: Float32Array | None = None


_PARTS: Parts = {
    "camera": ((DEPTH_CAMERA_INFO, msg_to_camera),),
    "pose": ((POSED_POSE, msg_to_pose),),
    "photo": ((IMAGE_COMPRESSED, compressed_to_rgb), (IMAGE_RAW, msg_to_rgb)),
    "depth": ((DEPTH_IMAGE, msg_to_depth),),
    "labels": ((LABELS_IMAGE, lambda m: msg_to_array(m, ("mono8",))),),
    "fused": ((FUSED_DEPTH, msg_to_depth),),
}
_NEEDED = ("camera", "pose", "photo", "depth", "labels")


def recorded_frames(bag: Path, site: Site) -> Iterator[RecordedFrame]:
    """The frames of a recorded run that came out with depth and labels, one camera after the other, in time order.

    A frame is handed out as soon as the bag has given all of it, so a bag of hours needs the memory of a few frames.
    """
    stream = FrameStream(bag, site.name, list(site.cameras), _PARTS)
    for camera in site.cameras:
        for frame in stream.frames(_NEEDED, [camera]):
            yield RecordedFrame(camera, frame.stamp_ns, **{part: frame.take(part) for part in _PARTS})
