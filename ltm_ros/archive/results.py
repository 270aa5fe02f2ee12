"""The folder that holds an archive's results, on disk or on S3: a file is there whole, or not at all."""

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
    """Files by their names below a folder: a path, or a URL such as `s3://bucket/prefix` of any store that fsspec has.

    Raises ArchiveError where the place, or a store that is not on this machine's disk, cannot be used; OSError where a
    file of this machine cannot be read or written just now.
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
        """Where it is on this machine's disk; None: elsewhere."""
        return Path(self._root) if "file" in _names(self._files.protocol) else None

    def names(self, folder: str) -> set[str]:
        """Of the files in a folder below."""
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
        """To read parts of it, and to do nothing else meanwhile that may fail."""
        with self._reached(), self._files.open(self._path(name), "rb") as file:
            yield file

    def write(self, name: str, content: bytes) -> None:
        """In one step: an object of S3 appears when it is whole, a file is written beside and renamed. Two that write
        the same name at once write the same content, for names of results tell what they hold."""
        if self.local is None:
            with self._reached():
                self._files.pipe_file(self._path(name), content)
        else:
            _write_whole(self.local / name, io.BytesIO(content))

    def put(self, file: Path, name: str) -> None:
        """Copy a file of this machine; to its own disk in pieces, for a terrain's store may be larger than memory."""
        if self.local is None:
            self.write(name, file.read_bytes())
            return
        with file.open("rb") as content:
            _write_whole(self.local / name, content)

    def remove(self, name: str) -> None:
        """A file that is there."""
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
            os.fsync(file.fileno())  # after a power cut, too, a name stands for all of its content
        partial.replace(place)
    except OSError:
        partial.unlink(missing_ok=True)
        raise


def _names(protocol: Any) -> tuple[str, ...]:
    return (protocol,) if isinstance(protocol, str) else tuple(protocol)
