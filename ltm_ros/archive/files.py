"""Find the files of archives, and store an archive's results in a folder; results appear completely or not at all."""

from __future__ import annotations

import io
import os
import shutil
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO


@dataclass(frozen=True)
class StoredFile:
    """`name`: its path. `version`: changes with the content."""

    name: str
    size_bytes: int
    version: str


def files_below(archive: Path) -> list[StoredFile]:
    """Return a file, or the files in a folder at any depth, by name; none if nothing exists. Raises OSError."""
    path = archive.expanduser().resolve()
    return [_on_disk(p) for p in ([path] if path.is_file() else _files_in(path))]


def _files_in(folder: Path) -> list[Path]:
    """Return files at any depth, by path, also behind links, each folder once; none without such a folder. A broken
    link, as to an unmounted share, counts as an unreadable file and is not skipped. Raises OSError for an unreadable
    folder, unlike `Path.rglob`."""

    def failed(error: OSError) -> None:
        if not (isinstance(error, FileNotFoundError) and error.filename == str(folder)):
            raise error

    found, known = list[Path](), set[str]()
    for place, below, names in os.walk(folder, onerror=failed, followlinks=True):
        real = os.path.realpath(place)
        if real in known:  # a link to a parent folder, or to one that is in the archive itself
            below.clear()
            continue
        known.add(real)
        below.sort()
        found += [Path(place) / name for name in names]
    return sorted(path for path in found if path.is_file() or path.is_symlink())


def _on_disk(path: Path) -> StoredFile:
    try:
        state = path.stat()
    except FileNotFoundError:
        return StoredFile(str(path), 0, "")
    return StoredFile(str(path), state.st_size, str(state.st_mtime_ns))


class ResultFolder:
    """Files by their names below a folder. Raises OSError if they cannot be read or written now."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.expanduser().resolve()

    def names(self, folder: str) -> set[str]:
        """Return the names of the files in a folder below."""
        place = self.folder / folder
        return {path.name for path in place.iterdir() if path.is_file()} if place.is_dir() else set()

    def has(self, name: str) -> bool:
        return (self.folder / name).exists()

    def read(self, name: str) -> bytes:
        return (self.folder / name).read_bytes()

    def open(self, name: str) -> BinaryIO:
        return (self.folder / name).open("rb")

    def write(self, name: str, content: bytes) -> None:
        """Write atomically. Names of results follow from their content, so that two writers write the same."""
        self._write(name, io.BytesIO(content))

    def put(self, file: Path, name: str) -> None:
        """Copy a file in pieces, because a terrain's store may be larger than memory."""
        with file.open("rb") as content:
            self._write(name, content)

    def remove(self, name: str) -> None:
        (self.folder / name).unlink()

    def _write(self, name: str, content: BinaryIO) -> None:
        place = self.folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        partial = place.with_name(f"{place.name}.{uuid.uuid4().hex}.partial")
        try:
            with partial.open("wb") as file:
                shutil.copyfileobj(content, file)
                file.flush()
                os.fsync(file.fileno())  # synced, so that after a power cut a name has its complete content
            partial.replace(place)
        except OSError:
            partial.unlink(missing_ok=True)
            raise
