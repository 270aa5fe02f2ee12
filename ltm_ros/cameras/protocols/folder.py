"""A folder that a camera writes its pictures into, such as an FTP drop."""

from __future__ import annotations

import contextlib
import itertools
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from ltm_core.site.source_config import FolderConfig
from ltm_core.storage.disk_io import is_folder
from ltm_ros.cameras.protocols.errors import PictureError, SourceError
from ltm_ros.cameras.protocols.exposure import exif_time
from ltm_ros.cameras.protocols.picture import CameraImage, CameraTime, Nothing, Timing
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
