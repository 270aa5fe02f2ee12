"""Pictures of one camera, from a folder or a recording: some of them, spread evenly over the time."""

from __future__ import annotations

from pathlib import Path

from ltm_core.base.errors import RecordingError
from ltm_core.base.evenly import evenly
from ltm_core.base.types import UInt8Array
from ltm_core.site.site import Site
from ltm_core.storage.photo_io import read_rgb
from ltm_core.vision.masks import Looking, ViewMask
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import compressed_to_rgb, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose
from ltm_ros.recordings.frame_stream import raw_stamp
from ltm_ros.runtime.topics import IMAGE_COMPRESSED, IMAGE_RAW, POSE, POSED_POSE, camera_topic

PICTURES = (".jpg", ".jpeg", ".png", ".heic", ".bmp", ".webp")
"""Endings of photos; .tif is left out: rasters are called so."""


def pictures_in(folder: Path, pattern: str = "*") -> list[Path]:
    """The photos of a folder by name, without label images. Raises RecordingError where there are none."""
    found = sorted(
        path
        for path in folder.glob(pattern)
        if path.suffix.lower() in PICTURES and path.is_file() and not path.stem.endswith(("_labels", "_mask"))
    )
    if not found:
        raise RecordingError(f"{folder}: no photos called {pattern!r}; {', '.join(PICTURES)} are read")
    return found


def folder_pictures(folder: Path, pattern: str, most: int) -> tuple[list[str], list[UInt8Array]]:
    """Names and photos, at most so many. Raises RecordingError and ImageError."""
    paths = evenly(pictures_in(folder, pattern), most)
    return [path.name for path in paths], [read_rgb(path) for path in paths]


def recorded_pictures(
    bag: Path, site: Site, camera: str, most: int, view: ViewMask | None = None
) -> tuple[list[str], list[UInt8Array]]:
    """Names by stamps, and pictures of a camera in a recording, at most so many; `view`: those that look there, by the
    poses of their stamps. Raises RecordingError, ImageError."""
    raw = site.camera(camera).image == "raw"
    topic = camera_topic(site.name, camera, IMAGE_RAW if raw else IMAGE_COMPRESSED)
    reader = BagReader(bag)
    stamps = [raw_stamp(message) for message in reader.messages([topic])]
    if not stamps:
        raise RecordingError(f"{bag}: no message on {topic}; it has {', '.join(reader.topics())}")
    numbers = list(range(len(stamps)))
    if view is not None:
        there = _looking_there(reader, site, camera, view)
        numbers = [number for number in numbers if stamps[number] in there]
        if not numbers:
            raise RecordingError(f"{bag}: no picture of {camera} has a pose that looks to view {view.name}")
    wanted = set(evenly(numbers, most))
    names, pictures = [], []
    for number, message in enumerate(reader.messages([topic])):
        if number in wanted:
            decoded = reader.decode(message)
            names.append(f"{camera}_{message.log_time_ns}")
            pictures.append(msg_to_rgb(decoded) if raw else compressed_to_rgb(decoded))
    return names, pictures


def _looking_there(reader: BagReader, site: Site, camera: str, view: ViewMask) -> set[int]:
    """Stamps of the camera's poses that look to the view. Of its zoom nothing is asked: pictures of other sizes are
    told by who compares them."""
    found = set()
    for topic in (POSE, POSED_POSE):
        for message in reader.messages([camera_topic(site.name, camera, topic)]):
            pose = msg_to_pose(reader.decode(message), "map")
            azimuth, pitch, _ = pose.angles_deg
            if Looking(azimuth, pitch, view.hfov_deg or 1.0).off_deg(view) <= view.within_deg:
                found.add(raw_stamp(message))
    return found
