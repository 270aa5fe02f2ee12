"""Keep a recorder's files as a ring: limited in bytes, the oldest complete files are deleted first."""

import fcntl
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Header

from ltm_core.base.errors import RecordingError
from ltm_msgs_py.bag.metadata import FILE_NAME
from ltm_msgs_py.bag.repair import repair_bag, rewrite_metadata

_HEAD = struct.Struct("<8sBQ")
_LONGEST_HEADER = 4096


class RecordingRing:
    """The bags `NAME`, `NAME_1`, `NAME_2`, ... of one folder, one per run of the recorder.

    It changes only MCAP files in such folders with the recorder's file names, whose header names this recorder
    (`library`), that are no links, that no process is writing, and that are not marked: by a file `<file>.keep` beside
    the file, or `.keep` in its folder."""

    def __init__(self, path: Path, recorder: str, most_bytes: int | None) -> None:
        """Open the ring. `path`: of the first bag. `most_bytes`: of all files that are not kept; None: unlimited."""
        self._path = path.resolve()
        self.library = f"ltm recorder {recorder} {self._path.name}"
        self.most_bytes = most_bytes

    def new_folder(self) -> Path:
        """Return the folder of the next bag, numbered after all others, so that names are in order of time."""
        folders = self._numbered()
        if not folders or ([path for _, path in folders] == [self._path] and not any(self._path.iterdir())):
            return self._path
        return self._path.with_name(f"{self._path.name}_{folders[-1][0] + 1}")

    def files(self) -> list[Path]:
        """Return all files of this recorder, the oldest first."""
        return [file for _, folder in self._numbered() for file in self._files_in(folder)]

    def sizes(self) -> dict[Path, int]:
        """Return the bytes of the files that are not marked, the oldest first."""
        return {
            file: file.stat().st_size
            for file in self.files()
            if not (file.with_name(".keep").exists() or file.with_name(f"{file.name}.keep").exists())
        }

    def repair(self) -> list[Path]:
        """Repair bags of a killed recorder; return them. What cannot be repaired now is left for the next start."""
        repaired = []
        for _, folder in self._numbered():
            files = self._files_in(folder)
            if not files or (folder / FILE_NAME).exists():
                continue
            with suppress(RecordingError, OSError), _held(files[-1]) as free:
                if free:
                    for leftover in folder.glob(".*.mcap.reserve"):
                        leftover.unlink(missing_ok=True)
                    repair_bag(folder, files)
                    repaired.append(folder)
        return repaired

    def make_room(self, wanted: int) -> list[Path]:
        """Remove the oldest files until `wanted` more bytes fit the limit; return them."""
        if self.most_bytes is None:
            return []
        sizes, removed = self.sizes(), []
        total = sum(sizes.values())
        for file, size in sizes.items():
            if total + wanted <= self.most_bytes:
                break
            if self._remove(file):
                total -= size
                removed.append(file)
        return removed

    def _remove(self, path: Path) -> bool:
        """Remove a file; return False if a process writes it, or it cannot be removed."""
        folder = path.parent
        with suppress(OSError, RecordingError), _held(path) as free:
            if free:
                left = [file for file in self._files_in(folder) if file != path]
                if (folder / FILE_NAME).exists():  # first, so that a bag never lists what is gone
                    rewrite_metadata(folder, left)
                path.unlink()
                if not left:
                    (folder / FILE_NAME).unlink(missing_ok=True)
                    with suppress(OSError):  # not empty: something that is not ours
                        folder.rmdir()
                return True
        return False

    def _numbered(self) -> list[tuple[int, Path]]:
        """Return the paths with the name of one of our bags, by number."""
        form = re.compile(rf"{re.escape(self._path.name)}(?:_([1-9]\d*))?")
        try:
            found = [(form.fullmatch(path.name), path) for path in self._path.parent.iterdir()]
        except OSError:
            return []
        return sorted((int(match[1] or 0), path) for match, path in found if match)

    def _files_in(self, folder: Path) -> list[Path]:
        if folder.is_symlink() or not folder.is_dir():
            return []
        form = re.compile(rf"{re.escape(folder.name)}_(\d+)\.mcap")
        named = [(form.fullmatch(path.name), path) for path in folder.iterdir()]
        numbered = sorted((int(match[1]), path) for match, path in named if match)
        return [path for _, path in numbered if not path.is_symlink() and path.is_file() and self._wrote(path)]

    def _wrote(self, path: Path) -> bool:
        """Return whether a file's header names this recorder."""
        try:
            with path.open("rb") as file:
                magic, opcode, length = _HEAD.unpack(file.read(_HEAD.size))
                if magic != b"\x89MCAP0\r\n" or opcode != Opcode.HEADER or length > _LONGEST_HEADER:
                    return False
                header = Header.read(ReadDataStream(BytesIO(file.read(length))))
        except (OSError, struct.error, McapError, ValueError):
            return False
        return bool(header.library == self.library)


@contextmanager
def _held(path: Path) -> Iterator[bool]:
    """Lock a file in the context; yields whether no process is writing it. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    free = False
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            free = True
        yield free
    finally:
        os.close(descriptor)
