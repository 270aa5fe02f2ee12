"""Find the photos of an import with their sensor data; detect the type of each file or folder by its content."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float64Array
from ltm_core.base.utc_time import stamp_of_moment
from ltm_core.cameras.sensor_pose import held_phone
from ltm_core.storage.text_io import LARGEST_FILE
from ltm_ros.recordings.importing.arkit import (
    is_record3d,
    is_stray_scanner,
    record3d_pictures,
    stray_scanner_pictures,
)
from ltm_ros.recordings.importing.assumptions import Assumptions, photo_time
from ltm_ros.recordings.importing.capture_files import CaptureFiles, is_zip
from ltm_ros.recordings.importing.photo import SUFFIXES, ImportedImage, Photo, photo_of, photos_in, read_photo
from ltm_ros.recordings.importing.sensor_logger import (
    camera_frames,
    is_sensor_logger,
    read_sensor_logger,
    read_sensor_logger_json,
)
from ltm_ros.recordings.importing.sensor_track import SensorTrack
from ltm_ros.recordings.importing.video import SUFFIXES as VIDEO_SUFFIXES
from ltm_ros.recordings.importing.video import is_video, video_pictures

_TURNED_DEG = {6: 0.0, 1: 90.0, 8: 180.0, 3: 270.0}
"""Orientation of a phone by the EXIF orientation of its back camera: its sensor's rows are along the screen's side."""


def find_pictures(paths: Iterable[Path], assumed: Assumptions) -> list[ImportedImage]:
    """Return the photos of files, folders, zips and videos. A sensor recording without photos of its own applies to all
    photos beside it, by their time.

    Raises RecordingError if a path does not exist, two photos share a name, there is none at all, or a file type is
    unknown.
    """
    paths = list(paths)
    found: list[ImportedImage] = []
    tracks: list[SensorTrack] = []
    for path in paths:
        if not path.exists():
            raise RecordingError(f"no photo, folder or recording at {path}")
        for part in _found_in(path, assumed):
            if isinstance(part, SensorTrack):
                tracks.append(part)
            else:
                found.append(part)
    if tracks:
        found = [_beside(picture, tracks, assumed) for picture in found]
    names: dict[str, Path] = {}
    for picture in found:
        if picture.name in names:
            raise RecordingError(f"two photos have the name {picture.name}: {names[picture.name]} and {picture.path}")
        names[picture.name] = picture.path
    if not found and tracks:
        raise RecordingError(
            f"{paths[0]}: a sensor recording without photos: record the app's sensor `Camera`, too, or add the "
            "photos taken meanwhile with another --images"
        )
    if not found:
        raise RecordingError(
            f"no photos in {', '.join(map(str, paths))}; supported: {', '.join((*SUFFIXES, *VIDEO_SUFFIXES))} and "
            "recordings of phones"
        )
    return found


def _found_in(path: Path, assumed: Assumptions) -> list[ImportedImage | SensorTrack]:
    if path.is_dir() or is_zip(path):
        files = CaptureFiles(path)
        if is_sensor_logger(files):
            return _sensor_logger(files)
        if is_stray_scanner(files):
            return [*stray_scanner_pictures(files, assumed)]
        if is_record3d(files):
            return [*record3d_pictures(files, assumed)]
        if path.is_dir():
            videos = [p for p in sorted(path.iterdir()) if p.suffix.lower() in VIDEO_SUFFIXES and is_video(p)]
            frames = [picture for video in videos for picture in video_pictures(video, assumed)]
            return [*(_photo_file(p) for p in photos_in(path)), *frames]
        raise RecordingError(
            f"{path}: a zip of an unknown app (it contains {', '.join(files.names[:5]) or 'nothing'}): without a "
            "Location table, the photos' positions are unknown; unpack it and give its folder of photos"
        )
    if path.suffix.lower() == ".json":
        track = read_sensor_logger_json(path)
        if track is None:
            raise RecordingError(f"{path}: is not a recording of Sensor Logger (a list of objects with `sensor`)")
        return [track]
    if is_video(path):
        return [*video_pictures(path, assumed)]
    return [_photo_file(path)]


def _photo_file(path: Path) -> ImportedImage:
    return ImportedImage(path.name, path, lambda: read_photo(path))


def _sensor_logger(files: CaptureFiles) -> list[ImportedImage | SensorTrack]:
    track = read_sensor_logger(files)
    frames = camera_frames(files)
    if not frames:
        return [track]

    def picture(member: str, stamp_ns: int) -> ImportedImage:
        path = files.path / Path(member).name
        return ImportedImage(
            path.name, path, lambda: _told(photo_of(files.read(member, LARGEST_FILE), path), track, stamp_ns)
        )

    return [picture(member, stamp_ns) for member, stamp_ns in frames.items()]


def _beside(picture: ImportedImage, tracks: list[SensorTrack], assumed: Assumptions) -> ImportedImage:
    """Complete a photo with sensor data that was recorded at its time."""

    def read() -> Photo:
        photo = picture.read()
        taken = photo_time(photo, None, assumed.time_zone, [])
        stamp_ns = stamp_of_moment(taken)
        for track in tracks:
            told = _told(photo, track, stamp_ns)
            if told.sensed.lon is not None:
                return told
        return photo if photo.sensed.lon is not None else _told(photo, tracks[0], stamp_ns)

    return replace(picture, read=read)


def _told(photo: Photo, track: SensorTrack, stamp_ns: int) -> Photo:
    """Return the photo with the track's values at its time, completed by its EXIF."""
    return replace(photo, sensed=track.at(stamp_ns, held(photo, track, stamp_ns)).over(photo.sensed))


def held(photo: Photo, track: SensorTrack, stamp_ns: int) -> Float64Array:
    """Return (3, 3): the upright photo's optical frame to the phone's axes, by how it was held.

    EXIF's orientation decides; without one a portrait was held upright, and a landscape on the side on which it is
    upright.
    """
    stated = photo.exif.orientation
    turned = (_TURNED_DEG[stated],) if stated != 1 and stated in _TURNED_DEG else ()
    rotation = track.rotation_at(stamp_ns)
    return held_phone(None if rotation is None else rotation.as_matrix(), photo.height > photo.width, turned)
