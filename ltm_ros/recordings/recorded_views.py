"""Reads from a recording which views its cameras took: calibrations and poses that a site file leaves to topics."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.site.site import Site
from ltm_core.visibility.viewshed import PosedCamera
from ltm_msgs_py.pose import msg_to_pose
from ltm_ros.recordings.frame_stream import PARTS, FrameStream
from ltm_ros.runtime.topics import POSE

_MOST = 12
"""Views of a camera that are kept."""
_ALIKE_DEG = 2.0


def recorded_views(bag: Path, site: Site) -> list[PosedCamera]:
    """The different views of each camera of the site, in the order in which they were taken, at most _MOST a camera;
    none of a camera that the recording does not have.

    Raises RecordingError where it has none of them.
    """
    stream = FrameStream.open(bag, site, {"camera": PARTS["camera"], "pose": ((POSE, _map_pose),)})
    cameras: dict[str, Camera] = {}
    poses: dict[str, list[Pose]] = {name: [] for name in site.cameras}
    for frame in stream.frames():
        with suppress(LtmError):  # a replay counts what is damaged
            if frame.camera_name not in cameras and "camera" in frame:
                cameras[frame.camera_name] = frame.take("camera")
        with suppress(LtmError):
            if len(poses[frame.camera_name]) < _MOST and "pose" in frame:
                _add(poses[frame.camera_name], frame.take("pose"))
    for name, config in site.cameras.items():
        if config.calibration is not None:
            cameras[name] = config.calibration.camera()
    views = [PosedCamera(name, cameras[name], pose) for name in cameras for pose in poses[name]]
    if not views:
        raise RecordingError(
            f"{bag}: holds no camera_info and pose of the cameras of {site.name} ({', '.join(site.cameras)}); its "
            f"topics are {stream.topics}"
        )
    return views


def _map_pose(message: Any) -> Pose:
    return msg_to_pose(message, "map")


def _add(poses: list[Pose], pose: Pose) -> None:
    azimuth, pitch, _ = pose.angles_deg
    for other in poses:
        turned = abs((azimuth - other.angles_deg[0] + 180) % 360 - 180)
        if turned < _ALIKE_DEG and abs(pitch - other.angles_deg[1]) < _ALIKE_DEG:
            return
    poses.append(pose)
