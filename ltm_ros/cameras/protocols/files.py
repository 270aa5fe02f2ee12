"""Read images that a camera writes into a folder, or that a network lists in a JSON file."""

import contextlib
import itertools
import json
import os
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from ltm_core.site.source_config import CameraListConfig, FolderConfig
from ltm_core.storage.disk_io import is_folder
from ltm_ros.cameras.protocols.credentials import PictureError, SourceError
from ltm_ros.cameras.protocols.exposure import epoch_of, exif_time
from ltm_ros.cameras.protocols.http_client import HttpClient, http_time
from ltm_ros.cameras.protocols.http_pictures import picture_in
from ltm_ros.cameras.protocols.picture import (
    CameraImage,
    CameraTime,
    Nothing,
    PtzReading,
    Timing,
    Tolerance,
    at_rest,
    stated_number,
)
from ltm_ros.runtime.clocks import SystemClock

MOST_FILES = 20_000
"""Maximum number of recent files that are checked, so that a faulty camera cannot fill the memory."""


@dataclass
class _Upload:
    """A file, as it was at the last check; one in progress changes until the next."""

    since: float
    """Monotonic seconds of the check that first saw it."""
    state: tuple[int, int] = (-1, -1)
    """Time of the last change in nanoseconds, and size in bytes."""
    done: bool = False


class FolderReader:
    """Returns files once each, in order of writing, when they are complete: unchanged since the previous check, with an
    end-of-image marker."""

    def __init__(self, config: FolderConfig, most_bytes: int, clock: SystemClock) -> None:
        self.pause = config.every
        self._config, self._most_bytes, self._clock = config, most_bytes, clock
        self._folder = config.path
        if not is_folder(self._folder):
            raise SourceError(f"{self._folder} is not a readable folder: create it, or correct path")
        try:
            self._zone = ZoneInfo(config.zone)
        except (ZoneInfoNotFoundError, ValueError, OSError):
            raise SourceError(f"unknown zone {config.zone!r}; give one such as America/Los_Angeles") from None
        self._uploads: dict[Path, _Upload] = {}

    def read(self) -> CameraImage | Nothing:
        now, wall = self._clock.monotonic(), self._clock.wall()
        files = self._look(wall)
        # Deleted files are forgotten, so that a name can be used again.
        self._uploads = {path: upload for path, upload in self._uploads.items() if path in files}
        for path, state in sorted(files.items(), key=lambda item: item[1]):
            upload = self._uploads.setdefault(path, _Upload(now))
            if upload.state != state:
                if upload.done:
                    upload.since, upload.done = now, False
                upload.state = state
            elif not upload.done and (data := self._whole(path, upload, now - upload.since)) is not None:
                self._finish(path, upload)
                return self._picture(path, data, now - (wall - state[0] / 1e9))
        return Nothing.YET

    def close(self) -> None:
        """Do nothing; no file is open."""

    def _look(self, wall: float) -> dict[Path, tuple[int, int]]:
        try:
            if not is_folder(self._folder):
                raise SourceError(f"{self._folder} does not exist any more: mount it, or correct path")
            return dict(itertools.islice(self._files(wall), MOST_FILES))
        except OSError as error:
            raise SourceError(f"{self._folder} cannot be read: {error.strerror}") from None

    def _files(self, wall: float) -> Iterator[tuple[Path, tuple[int, int]]]:
        home = self._folder.resolve()
        for path in self._folder.glob(self._config.pattern):
            with contextlib.suppress(OSError):
                state, upload = path.lstat(), self._uploads.get(path)
                # First, because most files of a folder that is never cleared are old.
                if wall - state.st_mtime > self._config.oldest and (upload is None or upload.done):
                    continue
                # A camera might write links, which could point anywhere.
                if stat.S_ISREG(state.st_mode) and path.resolve().is_relative_to(home):
                    yield path, (state.st_mtime_ns, state.st_size)

    def _whole(self, path: Path, upload: _Upload, waited: float) -> bytes | None:
        """Return the file's bytes; None if it may still grow. Raises PictureError if it will never be complete."""
        size = upload.state[1]
        if size > self._most_bytes:
            self._finish(path, upload)
            raise PictureError(f"{path.name} has {size} bytes; the maximum is {self._most_bytes}")
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
            with open(descriptor, "rb") as file:  # noqa: PTH123 # of a descriptor, so that no link is followed
                data = file.read(self._most_bytes + 1)
        except OSError:
            return None  # moved or deleted meanwhile; the next check shows it
        jpeg = data[:3] == b"\xff\xd8\xff" and data.rstrip(b"\0\r\n")[-2:] == b"\xff\xd9"
        if jpeg or (data[:8] == b"\x89PNG\r\n\x1a\n" and b"IEND" in data[-16:]):
            return data
        if waited < self._config.complete_within:
            return None
        self._finish(path, upload)
        raise PictureError(
            f"{path.name} has {len(data)} bytes and no end of image after {waited:.0f} s: its upload was interrupted"
        )

    def _finish(self, path: Path, upload: _Upload) -> None:
        upload.done = True
        if self._config.delete:
            with contextlib.suppress(OSError):
                path.unlink()

    def _picture(self, path: Path, data: bytes, written: float) -> CameraImage:
        pattern, trusted = self._config.name_time, self._config.clock == "trusted"
        if pattern is None:
            taken = exif_time(data, self._zone)
        else:
            try:
                moment = datetime.strptime(path.name, pattern)
            except ValueError:
                raise PictureError(f"{path.name} does not match {pattern}: correct name_time") from None
            taken = CameraTime(epoch_of(moment, self._zone), 0.001 if "%f" in pattern else 1.0, "name")
        return CameraImage(Timing(written, oldest=self._config.upload, taken=taken, trusted=trusted), jpeg=data)


_MOST_ENTRIES = 100_000
_MILLISECONDS = 1e11
"""Epoch values above this are milliseconds."""


class CameraListReader:
    """Reads the list, the image, and the list again; if the direction has changed, the camera counts as moving. An
    unchanged list is not transferred again."""

    def __init__(self, config: CameraListConfig, most_bytes: int) -> None:
        self.pause = config.every
        self._config = config
        self._client = HttpClient(config, most_bytes=most_bytes)
        self._image = config.image.replace("{id}", config.id)
        self._tag: dict[str, str] = {}
        self._entry: dict[str, Any] = {}
        self._given: object = None
        """Time of the image that was returned last."""

    def read(self) -> CameraImage | Nothing:
        entry = self._listed()
        stated = entry.get(self._config.time_key)
        if stated is not None and stated == self._given:
            return Nothing.UNCHANGED
        before = reading_of(entry, self._config)
        answer = self._client.get(self._image)
        picture = picture_in(answer)
        entry = self._listed()
        after = reading_of(entry, self._config)
        if entry.get(self._config.time_key) != stated:
            raise PictureError("the list already has a newer image than the one read; the next one is used")
        self._given = stated
        if before is not None and after is not None and not at_rest(before, after, Tolerance()):
            after = replace(after, moving=True)
        taken = time_of(stated) or http_time(answer.headers, "Last-Modified")
        return CameraImage(answer.timing(self._config.oldest, taken), jpeg=picture, direction=after)

    def close(self) -> None:
        self._client.close()

    def _listed(self) -> dict[str, Any]:
        """Return the camera's entry. Raises SourceError if the list is invalid or lacks it."""
        answer = self._client.get(self._config.url, self._tag)
        if answer.status != 304:
            self._entry = entry_of(answer.body, self._config)
            tag = answer.headers.get("etag")
            self._tag = {} if tag is None else {"If-None-Match": tag}
        return self._entry


def entry_of(body: bytes, config: CameraListConfig) -> dict[str, Any]:
    """Return the camera's entry in a list, in a mapping with a list (`cameras`, GeoJSON's `features`), or in a mapping
    by id. Raises SourceError if it is missing."""
    try:
        content = json.loads(body)
    except (ValueError, RecursionError):
        raise SourceError("the list of cameras is not valid JSON") from None
    if isinstance(content, dict):
        if isinstance(own := content.get(config.id), dict):
            return own
        content = next((value for value in content.values() if isinstance(value, list)), None)
    if isinstance(content, list):
        for item in content[:_MOST_ENTRIES]:
            entry = item.get("properties", item) if isinstance(item, dict) else None
            if isinstance(entry, dict) and str(entry.get(config.id_key)) == config.id:
                return entry
    raise SourceError(f"the list of cameras has no entry with {config.id_key} = {config.id!r}")


def reading_of(entry: dict[str, Any], config: CameraListConfig) -> PtzReading | None:
    """Return the viewing direction in the list; None if it is missing."""
    pan, tilt, zoom = (stated_number(entry.get(key)) for key in (config.pan_key, config.tilt_key, config.zoom_key))
    if pan is None or tilt is None:
        return None
    return PtzReading(pan, tilt, zoom if zoom is not None else 1.0, None, time.monotonic())


def time_of(value: Any) -> CameraTime | None:
    """Parse epoch seconds or milliseconds, or ISO 8601 (UTC without a zone); the resolution is 1 s without
    a fraction."""
    epoch = None if isinstance(value, bool) else stated_number(value)
    try:
        if epoch is None:
            epoch = epoch_of(datetime.fromisoformat(str(value)), UTC)
        elif epoch > _MILLISECONDS:
            epoch /= 1000
    except (ValueError, OverflowError):
        return None
    return CameraTime(epoch, 0.001 if epoch % 1 else 1.0, "list") if 0 < epoch < _MILLISECONDS else None
