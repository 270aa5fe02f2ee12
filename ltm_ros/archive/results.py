"""Store an archive's results in a folder, on disk or on S3; files appear completely or not at all."""

from __future__ import annotations

import io
import os
import posixpath
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import fsspec

from ltm_core.base.errors import ArchiveError


class ResultFolder:
    """Files by their names below a folder: a path, or a URL such as `s3://bucket/prefix` of any store that fsspec
    supports.

    Raises ArchiveError if a remote store or the place cannot be used; OSError if a local file cannot be read or written
    now.
    """

    def __init__(self, url: str) -> None:
        self.url = url if "://" in url else str(Path(url).expanduser().resolve())
        try:
            self._files, self._root = fsspec.core.url_to_fs(self.url)
        except (ImportError, ValueError) as error:
            raise ArchiveError(
                f"{url}: not a location for results ({error}); give a folder or s3://bucket/folder"
            ) from error

    @property
    def local(self) -> Path | None:
        """Return the path on this machine's disk; None: elsewhere."""
        return Path(self._root) if "file" in _names(self._files.protocol) else None

    def names(self, folder: str) -> set[str]:
        """Return the names of the files in a folder below."""
        place = self._path(folder)
        with self._reached():
            self._files.invalidate_cache()  # others may have written since
            if not self._files.exists(place):
                return set()
            found = self._files.ls(place, detail=True)
            return {posixpath.basename(about["name"]) for about in found if about["type"] != "directory"}

    def has(self, name: str) -> bool:
        with self._reached():
            self._files.invalidate_cache()
            return bool(self._files.exists(self._path(name)))

    def read(self, name: str) -> bytes:
        with self._reached():
            return bytes(self._files.cat_file(self._path(name)))

    @contextmanager
    def open(self, name: str) -> Iterator[BinaryIO]:
        """Open a file to read parts of it, without other work meanwhile that may fail."""
        with self._reached(), self._files.open(self._path(name), "rb") as file:
            yield file

    def write(self, name: str, content: bytes) -> None:
        """Write atomically: an object of S3 appears when it is complete, a file is renamed. Names of results follow
        from their content, so that two writers write the same.
        """
        if self.local is None:
            with self._reached():
                self._files.pipe_file(self._path(name), content)
        else:
            _write_whole(self.local / name, io.BytesIO(content))

    def put(self, file: Path, name: str) -> None:
        """Copy a local file; to a local disk in pieces, because a terrain's store may be larger than memory."""
        if self.local is None:
            self.write(name, file.read_bytes())
            return
        with file.open("rb") as content:
            _write_whole(self.local / name, content)

    def remove(self, name: str) -> None:
        """Remove an existing file."""
        with self._reached():
            self._files.rm_file(self._path(name))

    @contextmanager
    def _reached(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # of botocore, which has hundreds
            if self.local is not None:
                raise
            raise ArchiveError(
                f"{self.url} cannot be used now ({type(error).__name__}: {error}); check the address, the "
                "credentials and the network, then run again"
            ) from error

    def _path(self, name: str) -> str:
        return posixpath.join(self._root, name)


def _write_whole(place: Path, content: BinaryIO) -> None:
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


def _names(protocol: Any) -> tuple[str, ...]:
    return (protocol,) if isinstance(protocol, str) else tuple(protocol)
