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
from ltm_ros.cameras.protocols.direction import PtzReading, Tolerance, at_rest
from ltm_ros.cameras.protocols.exposure import exif_time
from ltm_ros.cameras.protocols.http_client import HttpClient, http_time
from ltm_ros.cameras.protocols.http_pictures import check_begins_as_picture
from ltm_ros.cameras.protocols.picture import CameraImage, CameraTime, Nothing, Timing, stated_number
from ltm_ros.runtime.clocks import Clock

MOST_FILES = 20_000
"""Young enough to be taken, that are looked at more closely: a camera gone mad shall not fill the memory."""


@dataclass(frozen=True)
class _FileState:
    """A file at one look; one that is being written has another size or time at the next."""

    size: int
    modified_ns: int


class FolderReader:
    """Gives the files one by one in the order in which they were written, each once, when it is whole: unchanged since
    the look before, and closed by an end-of-image marker."""

    def __init__(self, config: FolderConfig, most_bytes: int, clock: Clock) -> None:
        self.pause = config.every
        self._config, self._most_bytes, self._clock = config, most_bytes, clock
        self._folder = config.path
        if not is_folder(self._folder):
            raise SourceError(f"{self._folder} is no folder that can be read: make it, or mend path")
        try:
            self._zone = ZoneInfo(config.zone)
        except (ZoneInfoNotFoundError, ValueError, OSError):
            raise SourceError(f"zone {config.zone!r} is not known; write one such as America/Los_Angeles") from None
        self._waiting: dict[Path, tuple[_FileState, float]] = {}
        self._done: dict[Path, _FileState] = {}

    def read(self) -> CameraImage | Nothing:
        now, wall = self._clock.monotonic(), self._clock.wall()
        files = self._look(wall)
        # What is gone is forgotten, so that a name may come again.
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
        """Nothing is open."""

    def _look(self, wall: float) -> dict[Path, _FileState]:
        try:
            if not is_folder(self._folder):
                raise SourceError(f"{self._folder} is gone: mount it, or mend path")
            return dict(itertools.islice(self._files(wall), MOST_FILES))
        except OSError as error:
            raise SourceError(f"{self._folder} cannot be read: {error.strerror}") from None

    def _files(self, wall: float) -> Iterator[tuple[Path, _FileState]]:
        home = self._folder.resolve()
        for path in self._folder.glob(self._config.pattern):
            with contextlib.suppress(OSError):
                state = path.lstat()
                # First, for most files of a folder that nobody clears are old.
                if wall - state.st_mtime > self._config.oldest and path not in self._waiting:
                    continue
                # A link may lead anywhere, and a camera may write links.
                if stat.S_ISREG(state.st_mode) and path.resolve().is_relative_to(home):
                    yield path, _FileState(state.st_size, state.st_mtime_ns)

    def _whole(self, path: Path, seen: _FileState, waited: float) -> bytes | None:
        """The file's bytes; None where it may still grow. Raises PictureError where it will not be whole."""
        if seen.size > self._most_bytes:
            self._finish(path, seen)
            raise PictureError(f"{path.name} has {seen.size} bytes, at most {self._most_bytes} are taken")
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
            with open(descriptor, "rb") as file:  # noqa: PTH123 # of a descriptor, so that no link is followed
                data = file.read(self._most_bytes + 1)
        except OSError:
            return None  # moved or taken away meanwhile; the next look says
        if data[:3] == b"\xff\xd8\xff" and data.rstrip(b"\0\r\n")[-2:] == b"\xff\xd9":
            return data
        if data[:8] == b"\x89PNG\r\n\x1a\n" and b"IEND" in data[-16:]:
            return data
        if waited < self._config.complete_within:
            return None
        self._finish(path, seen)
        raise PictureError(
            f"{path.name} has {len(data)} bytes and no end of a picture after {waited:.0f} s: its upload broke off"
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
            raise PictureError(f"{path.name} does not read as {pattern}: mend name_time") from None
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=self._zone)
        return CameraTime(moment.timestamp(), 0.001 if "%f" in pattern else 1.0, "name")


_MOST_ENTRIES = 100_000
_MILLISECONDS = 1e11
"""An epoch beyond it is stated in milliseconds."""


class CameraListReader:
    """Reads the list, the picture, and the list again: where the list has another direction by then, the camera is
    taken to have moved. A list that has not changed is not sent again."""

    def __init__(self, config: CameraListConfig, most_bytes: int) -> None:
        self.pause = config.every
        self._config = config
        self._client = HttpClient(config, most_bytes=most_bytes)
        self._image = config.image.replace("{id}", config.id)
        self._tag: dict[str, str] = {}
        self._entry: dict[str, Any] = {}
        self._given: object = None
        """The time of the picture that was given last."""

    def read(self) -> CameraImage | Nothing:
        entry = self._listed()
        stated = entry.get(self._config.time_key)
        if stated is not None and stated == self._given:
            return Nothing.UNCHANGED
        before = reading_of(entry, self._config)
        answer = self._client.get(self._image)
        check_begins_as_picture(answer)
        entry = self._listed()
        after = reading_of(entry, self._config)
        if entry.get(self._config.time_key) != stated:
            raise PictureError("the list has a newer picture than the one that was read; the next one will be taken")
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
        return CameraImage(timing, jpeg=answer.body, direction=direction)

    def close(self) -> None:
        self._client.close()

    def _listed(self) -> dict[str, Any]:
        """The camera's entry. Raises SourceError where the list is none, or does not have it."""
        answer = self._client.get(self._config.url, self._tag)
        if answer.status == 304:
            return self._entry
        self._entry = entry_of(answer.body, self._config)
        tag = answer.headers.get("etag")
        self._tag = {} if tag is None else {"If-None-Match": tag}
        return self._entry


def entry_of(body: bytes, config: CameraListConfig) -> dict[str, Any]:
    """The camera's entry of a list, of a mapping that holds one (`cameras`, GeoJSON's `features`), or of a mapping by
    id. Raises SourceError where there is none."""
    try:
        content = json.loads(body)
    except (ValueError, RecursionError):
        raise SourceError("the list of cameras is no JSON") from None
    if isinstance(content, dict):
        if isinstance(own := content.get(config.id), dict):
            return own
        content = next((value for value in content.values() if isinstance(value, list)), None)
    if isinstance(content, list):
        for item in content[:_MOST_ENTRIES]:
            entry = item.get("properties", item) if isinstance(item, dict) else None
            if isinstance(entry, dict) and str(entry.get(config.id_key)) == config.id:
                return entry
    raise SourceError(f"the list of cameras has none whose {config.id_key} is {config.id!r}")


def reading_of(entry: dict[str, Any], config: CameraListConfig) -> PtzReading | None:
    """Where the list says that the camera looks; None where it does not say."""
    pan, tilt, zoom = (stated_number(entry.get(key)) for key in (config.pan_key, config.tilt_key, config.zoom_key))
    if pan is None or tilt is None:
        return None
    return PtzReading(pan, tilt, zoom if zoom is not None else 1.0, None, time.monotonic())


def time_of(value: Any) -> CameraTime | None:
    """Epoch seconds or milliseconds, or ISO 8601, which without a zone is UTC; whole seconds unless a fraction is
    stated."""
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
