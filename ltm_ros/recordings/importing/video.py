"""Read frames, times and tags of videos, and return them as photos."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.storage.image_io import MAX_PIXELS
from ltm_msgs_py.image import encode_rgb
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.dji import Flight, read_subtitles, subtitles_of
from ltm_ros.recordings.importing.exif import ExifFacts, positive
from ltm_ros.recordings.importing.intrinsics import LensFacts, lens_of_video
from ltm_ros.recordings.importing.photo import ImportedImage, Photo
from ltm_ros.recordings.importing.sensor_track import Sensed

SUFFIXES = (".mp4", ".mov", ".m4v")
MOST_FRAMES = 20_000
_FIRST_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
_STILL_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"avif", b"avis")
_ISO6709 = re.compile(r"([+-]\d+(?:\.\d+)?)([+-]\d+(?:\.\d+)?)([+-]\d+(?:\.\d+)?)?(?:CRS[^/]*)?/?")
_TAGS = (
    *("com.apple.quicktime.location.ISO6709", "com.apple.quicktime.location.iso6709"),
    *("location", "location-eng", "com.android.location"),
)
_EPOCH_1904 = datetime(1971, 1, 1, tzinfo=UTC)
"""Cameras without a clock write 0, which is 1904."""


@dataclass(frozen=True)
class Video:
    """`begins`: its first frame's time, with its zone; None if not stated. `times`: seconds after it of the requested
    frames. `lat`, `lon`, `altitude`: one position for the whole video, above sea level; `position_sigma`: metres.
    `maker`: of the camera, empty if not stated."""

    path: Path
    begins: datetime | None
    times: tuple[float, ...]
    lat: float | None = None
    lon: float | None = None
    altitude: float | None = None
    position_sigma: float | None = None
    lens: LensFacts = field(default_factory=LensFacts)
    maker: str = ""

    def upright(self, seconds: float) -> UInt8Array:
        """Return the first frame from then on, (H, W, 3) RGB, rotated as the video states. Raises RecordingError."""
        pixels, turn_deg = self._frame(seconds)
        # The turn that shows it upright is counter-clockwise, as NumPy's.
        return np.ascontiguousarray(np.rot90(pixels, round(turn_deg / 90) % 4))

    def _frame(self, seconds: float) -> tuple[UInt8Array, float]:
        with _opened(self.path) as container:
            stream = container.streams.video[0]
            start = float((stream.start_time or 0) * stream.time_base)
            container.seek(max(0, math.floor((start + seconds) / stream.time_base)), stream=stream)
            found: Any = None
            for frame in container.decode(stream):
                found = frame
                if frame.time is not None and frame.time - start >= seconds - 1e-3:
                    break
            if found is None:
                raise RecordingError(
                    f"{self.path}: no frame at {seconds:.2f} s: the video is truncated; export it again"
                )
            return np.asarray(found.to_ndarray(format="rgb24"), np.uint8), float(found.rotation)


def is_video(path: Path) -> bool:
    """Return whether it is a video, by its first box: ISO 14496-12's `ftyp`, or one of QuickTime's in older files. HEIC
    and AVIF begin alike and name themselves."""
    try:
        with path.open("rb") as file:
            head = file.read(12)
    except OSError:
        return False
    return head[4:8] in _FIRST_BOXES and head[8:12] not in _STILL_BRANDS


def read_video(path: Path, every: float) -> Video:
    """Return a video's metadata, with the times of a frame every `every` seconds. Raises RecordingError if it cannot be
    read, or has no images."""
    with _opened(path) as container:
        stream = container.streams.video[0]
        if stream.width * stream.height > MAX_PIXELS:
            raise RecordingError(
                f"{path}: frames of {stream.width} x {stream.height} pixels are too large; export a smaller video"
            )
        duration = (
            float(stream.duration * stream.time_base) if stream.duration else float(container.duration or 0) / 1e6
        )
        count = max(1, math.ceil(duration / every - 1e-6))
        if count > MOST_FRAMES:
            raise RecordingError(f"{path}: {count} frames, more than {MOST_FRAMES}: increase the interval (--every)")
        tags = {str(key): str(value) for key, value in {**stream.metadata, **container.metadata}.items()}
    lat, lon, altitude = _place(tags)
    return Video(
        path,
        _begins(tags),
        tuple(k * every for k in range(count)),
        lat,
        lon,
        altitude,
        positive(tags.get("com.apple.quicktime.location.accuracy.horizontal")),
        lens_of_video(tags),
        tags.get("com.apple.quicktime.make", tags.get("make", "")),
    )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        import av
    except ImportError as error:
        raise RecordingError(f"{path}: reading videos needs PyAV: pip install 'ltm[video]'") from error
    try:
        # From an open file and only in this format, so that no playlist or link in it is followed.
        with path.open("rb") as file, av.open(file, "r", format="mov") as container:
            if not container.streams.video:
                raise RecordingError(f"{path}: a video without images; give the camera's original file")
            if container.streams.video[0].codec_context is None:
                raise RecordingError(f"{path}: FFmpeg does not know its encoding; export it as H.264")
            yield container
    except (av.FFmpegError, OSError, ValueError, TypeError, OverflowError, MemoryError, ZeroDivisionError) as error:
        raise RecordingError(
            f"{path}: cannot be read as a video ({type(error).__name__}: {error}); export or copy it again"
        ) from error


def _place(tags: dict[str, str]) -> tuple[float | None, float | None, float | None]:
    """Parse ISO 6709: latitude, longitude and, if stated, height."""
    for tag in _TAGS:
        found = _ISO6709.fullmatch(tags.get(tag, "").strip())
        if found is not None:
            lat, lon = float(found[1]), float(found[2])
            if abs(lat) <= 90 and abs(lon) <= 180 and (lat, lon) != (0.0, 0.0):
                return lat, lon, float(found[3]) if found[3] else None
    return None, None, None


def _begins(tags: dict[str, str]) -> datetime | None:
    """Return the start time. Apple's own date has a zone; `creation_time` is UTC by ISO 14496-12."""
    for tag in ("com.apple.quicktime.creationdate", "creation_time"):
        try:
            found = datetime.fromisoformat(tags.get(tag, "").replace("Z", "+00:00"))
        except ValueError:
            continue
        found = found if found.tzinfo is not None else found.replace(tzinfo=UTC)
        if found > _EPOCH_1904:
            return found
    return None


def later(begins: datetime, seconds: float) -> datetime:
    """Return a later time. Raises RecordingError for one outside the calendar."""
    try:
        return begins + timedelta(seconds=seconds)
    except OverflowError as error:
        raise RecordingError(f"{seconds:g} s after {begins.isoformat()} is not a valid time") from error


QUALITY = 95
_GIMBAL = np.eye(3)
"""A source of the gimbal's angles gives the camera's."""


def video_pictures(path: Path, assumed: Assumptions) -> list[ImportedImage]:
    """Return a frame every `assumed.every` seconds. Raises RecordingError for an unreadable video or telemetry."""
    video = read_video(path, assumed.every)
    flight, missing = _telemetry(path, assumed)

    def picture(seconds: float) -> ImportedImage:
        name = f"{path.stem}_{round(seconds * 1000):07d}.jpg"
        place = path / name

        def read() -> Photo:
            lens = (flight.lens_at(seconds) if flight is not None else None) or video.lens
            return frame_photo(video.upright(seconds), place, _sensed(video, flight, missing, seconds), lens)

        return ImportedImage(name, place, read, capture=path.name)

    return [picture(seconds) for seconds in video.times]


def frame_photo(pixels: UInt8Array, path: Path, sensed: Sensed, lens: LensFacts | None = None) -> Photo:
    """Return a photo of decoded pixels (H, W, 3)."""
    height, width = pixels.shape[:2]
    data = encode_rgb(pixels, "jpeg", QUALITY)
    return Photo(path, data, "jpeg", width, height, ExifFacts(), sensed, True, lens or LensFacts())


def _telemetry(path: Path, assumed: Assumptions) -> tuple[Flight | None, str]:
    """Return the flight, or the reason why its subtitles give none; then a pose file must place the frames."""
    subtitles = subtitles_of(path)
    try:
        return None if subtitles is None else read_subtitles(subtitles, assumed.covers), ""
    except RecordingError as error:
        return None, "" if assumed.keep_unknown else str(error)  # subtitles of speech


def _sensed(video: Video, flight: Flight | None, missing: str, seconds: float) -> Sensed:
    begins = (flight.begins if flight is not None else None) or video.begins
    stamp = later(begins, seconds) if begins is not None else None
    if missing:
        return Sensed(source="its subtitles", missing=missing, stamp=stamp, seconds=seconds, in_flight=True)
    own = Sensed(
        source=f"the video's tags ({video.maker})" if video.maker else "the video's tags",
        lon=video.lon,
        lat=video.lat,
        altitude=video.altitude,
        position_sigma=video.position_sigma,
    )
    told = own if flight is None else flight.track.at(1 + round(seconds * 1e9), _GIMBAL).over(own)
    return replace(told, stamp=stamp, seconds=seconds, in_flight=flight is not None)
