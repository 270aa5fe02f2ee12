"""Read images and views of single cameras from a folder or a recording."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.base.evenly import evenly
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.site.site import Site
from ltm_core.storage.text_io import read_rgb
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.mask_config import ViewMask
from ltm_core.vision.masks import Looking
from ltm_msgs_py.pose import msg_to_pose
from ltm_ros.recordings.frame_stream import PARTS, FrameStream
from ltm_ros.runtime.topics import POSE

PICTURES = (".jpg", ".jpeg", ".png", ".heic", ".bmp", ".webp")
"""Suffixes of photos; .tif is excluded, because rasters use it."""


def pictures_in(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the photos of a folder by name, without label images. Raises RecordingError if there are none."""
    found = sorted(
        path
        for path in folder.glob(pattern)
        if path.suffix.lower() in PICTURES and path.is_file() and not path.stem.endswith(("_labels", "_mask"))
    )
    if not found:
        raise RecordingError(f"{folder}: no photos match {pattern!r}; supported: {', '.join(PICTURES)}")
    return found


def folder_pictures(folder: Path, pattern: str, most: int) -> tuple[list[str], list[UInt8Array]]:
    """Yield names and photos, at most `most`. Raises RecordingError and ImageError."""
    paths = evenly(pictures_in(folder, pattern), most)
    return [path.name for path in paths], [read_rgb(path) for path in paths]


def recorded_pictures(
    bag: Path, site: Site, camera: str, most: int, view: ViewMask | None = None
) -> tuple[list[str], list[UInt8Array]]:
    """Return names by stamps, and images of a camera in a recording, `most` of them at most.

    `view`: only images with this viewing direction; the zoom does not matter. Raises RecordingError, ImageError.
    """
    site.camera(camera)
    stream = FrameStream(bag, site.name, [camera], {part: PARTS[part] for part in ("photo", "pose")})
    if not stream.has("photo"):
        raise RecordingError(f"{bag}: no image of {camera}; its topics are {stream.topics}")
    needed = ("photo",) if view is None else ("photo", "pose")
    stamps = [f.stamp_ns for f in stream.frames(needed) if view is None or _looks_at(f.take("pose"), view)]
    if not stamps:
        raise RecordingError(
            f"{bag}: no image of {camera} has a pose in the direction of view {view.name if view else ''}"
        )
    wanted = set(evenly(stamps, most))
    frames = [(f.stamp_ns, f.take("photo")) for f in stream.frames(needed) if f.stamp_ns in wanted]
    return [f"{camera}_{stamp}" for stamp, _ in frames], [photo for _, photo in frames]


def _looks_at(pose: Pose, view: ViewMask) -> bool:
    azimuth, pitch, _ = pose.angles_deg
    return Looking(azimuth, pitch, view.hfov_deg or 1.0).off_deg(view) <= view.within_deg


_MOST = 12
"""Maximum number of views per camera."""
_ALIKE_DEG = 2.0


def recorded_views(bag: Path, site: Site) -> list[PosedCamera]:
    """Return the different views of each camera of the site, in order of time, at most _MOST per camera; none of a
    camera that is not in the recording.

    Raises RecordingError if there are none at all.
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
            f"{bag}: contains no camera_info and pose of the cameras of {site.name} ({', '.join(site.cameras)}); "
            f"its topics are {stream.topics}"
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
