"""The frames of a video as photos, with the data in its tags and in the file beside it."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.cameras.camera_config import PartialCalibration
from ltm_msgs_py.image import encode_rgb
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.dji import read_subtitles, subtitles_of
from ltm_ros.recordings.importing.exif import FULL_FRAME_WIDTH_MM, ExifFacts
from ltm_ros.recordings.importing.photo import Photo
from ltm_ros.recordings.importing.picture import ImportedImage
from ltm_ros.recordings.importing.sensed import Sensed
from ltm_ros.recordings.importing.sensor_track import SensorTrack
from ltm_ros.recordings.importing.video import Video, later, read_video

QUALITY = 95
_GIMBAL = np.eye(3)
"""What tells the gimbal's angles tells the camera's."""


def video_pictures(path: Path, assumed: Assumptions) -> list[ImportedImage]:
    """A frame each `assumed.every` seconds. Raises RecordingError for a video or telemetry that cannot be read."""
    video = read_video(path, assumed.every)
    track, begins, focal = _telemetry(path, assumed)
    begins = begins or video.begins

    def picture(seconds: float) -> ImportedImage:
        name = f"{path.stem}_{round(seconds * 1000):07d}.jpg"
        place = path / name

        def read() -> Photo:
            pixels = video.upright(seconds)
            calibration = _calibration(focal or video.focal_35mm, pixels)
            return frame_photo(pixels, place, _sensed(video, track, begins, seconds, calibration))

        return ImportedImage(name, place, read, capture=path.name)

    return [picture(seconds) for seconds in video.times]


def frame_photo(pixels: UInt8Array, path: Path, sensed: Sensed) -> Photo:
    """A photo of decoded pixels (H, W, 3)."""
    height, width = pixels.shape[:2]
    return Photo(path, encode_rgb(pixels, "jpeg", QUALITY), "jpeg", width, height, ExifFacts(), sensed, reencoded=True)


def _telemetry(path: Path, assumed: Assumptions) -> tuple[SensorTrack | None, datetime | None, float | None]:
    subtitles = subtitles_of(path)
    if subtitles is None:
        return None, None, None
    try:
        return read_subtitles(subtitles, assumed.time_zone)
    except RecordingError:
        if assumed.keep_unknown:  # subtitles of speech
            return None, None, None
        raise


def _sensed(
    video: Video, track: SensorTrack | None, begins: datetime | None, seconds: float, calibration: PartialCalibration
) -> Sensed:
    stamp = later(begins, seconds) if begins is not None else None
    own = Sensed(
        source=f"the video's tags ({video.maker})" if video.maker else "the video's tags",
        lon=video.lon,
        lat=video.lat,
        altitude=video.altitude,
        position_sigma=video.position_sigma,
    )
    told = own if track is None else track.at(1 + round(seconds * 1e9), _GIMBAL).over(own)
    return replace(told, stamp=stamp, seconds=seconds, calibration=calibration)


def _calibration(focal_35mm: float | None, pixels: UInt8Array) -> PartialCalibration:
    if focal_35mm is None:
        return PartialCalibration()
    return PartialCalibration(fx=focal_35mm / FULL_FRAME_WIDTH_MM * max(pixels.shape[:2]))
