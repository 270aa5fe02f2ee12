"""Read images that a camera writes into a folder, or that a network lists in a JSON file."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from ltm_core.site.source_config import CameraListConfig, FolderConfig
from ltm_core.storage.disk_io import is_folder
from ltm_ros.cameras.protocols.credentials import PictureError, SourceError
from ltm_ros.cameras.protocols.exposure import exif_time
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
from ltm_ros.runtime.clocks import Clock

MOST_FILES = 20_000
"""Maximum number of recent files that are checked, so that a faulty camera cannot fill the memory."""


@dataclass(frozen=True)
class _FileState:
    """State of a file at one check; a file in progress changes its size or time until the next."""

    size: int
    modified_ns: int


class FolderReader:
    """Returns files once each, in order of writing, when they are complete: unchanged since the previous check, with an
    end-of-image marker."""

    def __init__(self, config: FolderConfig, most_bytes: int, clock: Clock) -> None:
        self.pause = config.every
        self._config, self._most_bytes, self._clock = config, most_bytes, clock
        self._folder = config.path
        if not is_folder(self._folder):
            raise SourceError(f"{self._folder} is not a readable folder: create it, or correct path")
        try:
            self._zone = ZoneInfo(config.zone)
        except (ZoneInfoNotFoundError, ValueError, OSError):
            raise SourceError(f"unknown zone {config.zone!r}; give one such as America/Los_Angeles") from None
        self._waiting: dict[Path, tuple[_FileState, float]] = {}
        self._done: dict[Path, _FileState] = {}

    def read(self) -> CameraImage | Nothing:
        now, wall = self._clock.monotonic(), self._clock.wall()
        files = self._look(wall)
        # Deleted files are forgotten, so that a name can be used again.
        self._done = {path: seen for path, seen in self._done.items() if path in files}
        self._waiting = {path: entry for path, entry in self._waiting.items() if path in files}
        new = [(seen.modified_ns, path, seen) for path, seen in files.items() if self._done.get(path) != seen]
        for modified_ns, path, seen in sorted(new):
            former, since = self._waiting.get(path, (None, now))
            self._waiting[path] = seen, since
            if former != seen:
                continue
            data = self._whole(path, seen, now - since)
            if data is not None:
                self._finish(path, seen)
                return self._picture(path, data, now - (wall - modified_ns / 1e9))
        return Nothing.YET

    def close(self) -> None:
        """Do nothing; no file is open."""

    def _look(self, wall: float) -> dict[Path, _FileState]:
        try:
            if not is_folder(self._folder):
                raise SourceError(f"{self._folder} does not exist any more: mount it, or correct path")
            return dict(itertools.islice(self._files(wall), MOST_FILES))
        except OSError as error:
            raise SourceError(f"{self._folder} cannot be read: {error.strerror}") from None

    def _files(self, wall: float) -> Iterator[tuple[Path, _FileState]]:
        home = self._folder.resolve()
        for path in self._folder.glob(self._config.pattern):
            with contextlib.suppress(OSError):
                state = path.lstat()
                # First, because most files of a folder that is never cleared are old.
                if wall - state.st_mtime > self._config.oldest and path not in self._waiting:
                    continue
                # A camera might write links, which could point anywhere.
                if stat.S_ISREG(state.st_mode) and path.resolve().is_relative_to(home):
                    yield path, _FileState(state.st_size, state.st_mtime_ns)

    def _whole(self, path: Path, seen: _FileState, waited: float) -> bytes | None:
        """Return the file's bytes; None if it may still grow. Raises PictureError if it will never be complete."""
        if seen.size > self._most_bytes:
            self._finish(path, seen)
            raise PictureError(f"{path.name} has {seen.size} bytes; the maximum is {self._most_bytes}")
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
            with open(descriptor, "rb") as file:  # noqa: PTH123 # of a descriptor, so that no link is followed
                data = file.read(self._most_bytes + 1)
        except OSError:
            return None  # moved or deleted meanwhile; the next check shows it
        if data[:3] == b"\xff\xd8\xff" and data.rstrip(b"\0\r\n")[-2:] == b"\xff\xd9":
            return data
        if data[:8] == b"\x89PNG\r\n\x1a\n" and b"IEND" in data[-16:]:
            return data
        if waited < self._config.complete_within:
            return None
        self._finish(path, seen)
        raise PictureError(
            f"{path.name} has {len(data)} bytes and no end of image after {waited:.0f} s: its upload was interrupted"
        )

    def _finish(self, path: Path, seen: _FileState) -> None:
        self._waiting.pop(path, None)
        self._done[path] = seen
        if self._config.delete:
            with contextlib.suppress(OSError):
                path.unlink()

    def _picture(self, path: Path, data: bytes, written: float) -> CameraImage:
        timing = Timing(
            arrived=written,
            oldest=self._config.upload,
            taken=self._named_time(path) or exif_time(data, self._zone),
            trusted=self._config.clock == "trusted",
        )
        return CameraImage(timing, jpeg=data)

    def _named_time(self, path: Path) -> CameraTime | None:
        pattern = self._config.name_time
        if pattern is None:
            return None
        try:
            moment = datetime.strptime(path.name, pattern)
        except ValueError:
            raise PictureError(f"{path.name} does not match {pattern}: correct name_time") from None
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=self._zone)
        return CameraTime(moment.timestamp(), 0.001 if "%f" in pattern else 1.0, "name")


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
        direction = after
        if before is not None and after is not None and not at_rest(before, after, Tolerance()):
            direction = PtzReading(after.pan_deg, after.tilt_deg, after.zoom, True, after.at)
        timing = Timing(
            arrived=answer.arrived,
            asked=answer.asked,
            oldest=self._config.oldest,
            taken=time_of(stated) or http_time(answer.headers, "Last-Modified"),
            answered=http_time(answer.headers, "Date"),
        )
        return CameraImage(timing, jpeg=picture, direction=direction)

    def close(self) -> None:
        self._client.close()

    def _listed(self) -> dict[str, Any]:
        """Return the camera's entry. Raises SourceError if the list is invalid or lacks it."""
        answer = self._client.get(self._config.url, self._tag)
        if answer.status == 304:
            return self._entry
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
    number = None if isinstance(value, bool) else stated_number(value)
    if number is not None:
        epoch = number / 1000 if number > _MILLISECONDS else number
        return CameraTime(epoch, 0.001 if epoch % 1 else 1.0, "list") if 0 < epoch < _MILLISECONDS else None
    try:
        moment = datetime.fromisoformat(str(value))
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=UTC)
        return CameraTime(moment.timestamp(), 0.001 if moment.microsecond else 1.0, "list")
    except (ValueError, OverflowError):
        return None
