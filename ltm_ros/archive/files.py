"""Read the files of archives: on local disks, or fetched from a store such as S3.

Failed requests to a store are repeated, and then become an error that names it, never a result.
"""

from __future__ import annotations

import errno
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import fsspec

from ltm_core.base.errors import ArchiveError
from ltm_ros.archive.content_digest import digest
from ltm_ros.runtime.retry import Backoff

TRIES, FIRST_WAIT_S = 5, 0.5
"""Maximum number of requests to a store, and the pause after the first one, which then doubles. The store's library
repeats each request by itself, as often as `AWS_MAX_ATTEMPTS` says."""
_VERSIONS = ("ETag", "etag", "mtime", "LastModified", "created")
"""Properties of an object that show a change; the first one present is used."""
_OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
"""Errors of the disk, not of the store."""
_PARTIAL = ".partial"
_POLL_S = 0.05
_CHANGES = 5
"""Number of times that a file may change while it is fetched."""

T = TypeVar("T")


@dataclass(frozen=True)
class CacheConfig:
    """Folder for files of stores while they are read, and its maximum bytes; shared by the workers."""

    folder: str = str(Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "ltm")
    most_bytes: int = 20 * 10**9

    @property
    def own(self) -> Path:
        """Return our own folder below `folder`, which may hold other files."""
        return Path(self.folder).expanduser() / "archive_files"


@dataclass(frozen=True)
class StoredFile:
    """`name`: its path, or its URL on a store. `version`: changes with the content."""

    name: str
    size_bytes: int
    version: str


def is_remote(name: str) -> bool:
    return "://" in name


def files_below(archive: str) -> list[StoredFile]:
    """Return a file, or the files in a folder at any depth, by name; none if nothing exists.

    Raises ArchiveError if a store fails, OSError if a disk does.
    """
    if not is_remote(archive):
        path = Path(archive).expanduser().resolve()
        return [_on_disk(p) for p in ([path] if path.is_file() else _files_in(path))]
    store, root = _store_of(archive)
    found = asked(archive, lambda: store.find(root, detail=True))
    return sorted((_on_store(store, about) for about in found.values()), key=lambda file: file.name)


def _files_in(folder: Path) -> list[Path]:
    """Return files at any depth, by path, also behind links, each folder once; none without such a folder. A broken
    link, as to an unmounted share, counts as an unreadable file and is not skipped. Raises OSError for an unreadable
    folder, unlike `Path.rglob`.
    """

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


def _on_store(store: Any, about: dict[str, Any]) -> StoredFile:
    version = next((f"{key} {about[key]}" for key in _VERSIONS if about.get(key)), "")
    return StoredFile(store.unstrip_protocol(about["name"]), int(about["size"] or 0), version)


class ArchiveFiles:
    """Provides files of archives as local files."""

    def __init__(self, cache: CacheConfig) -> None:
        self._cache = cache

    @contextmanager
    def at_hand(self, name: str) -> Iterator[Path]:
        """Keep the file while the context lasts. Raises ArchiveError if it cannot be fetched or exceeds the cache,
        OSError if the local disk fails.
        """
        if not is_remote(name):
            yield Path(name)
            return
        store, path = _store_of(name)
        for _ in range(_CHANGES):
            about = asked(name, lambda: _fresh(store, path))
            place = self._place(about)
            if not place.is_file():
                self._fetch(store, path, about)
            if (held := _held(place)) is not None:
                with held:
                    os.utime(place)
                    yield place
                    return
        raise ArchiveError(
            f"{name} changed, or was deleted from the cache, each of {_CHANGES} times that it was fetched; wait "
            "until it is complete, or raise --cache-gb"
        )

    def _place(self, about: StoredFile) -> Path:
        suffix = Path(about.name).suffix
        key = digest(about.name, about.size_bytes, about.version)
        return self._cache.own / f"{key}{suffix}"

    def _fetch(self, store: Any, path: str, about: StoredFile) -> None:
        """Fetch a file into the cache, unless it has changed meanwhile. Other processes that need it wait."""
        place = self._place(about)
        place.parent.mkdir(parents=True, exist_ok=True)
        partial = place.with_name(f"{place.name}{_PARTIAL}")
        # Polled: the file that another process fetches becomes the one in place, which it then holds for reading; a
        # process queued for the lock would wait for that, too.
        while (own := _held(partial, alone=True)) is None:
            if place.is_file():
                return
            time.sleep(_POLL_S)
        with own:
            # An existing file may be in use, and must then stay the file of its name.
            if place.is_file():
                partial.unlink()
                return
            try:
                self._make_room(about)

                def fetch() -> bool:
                    store.get_file(path, str(partial))
                    found = _fresh(store, path)
                    if partial.stat().st_size != found.size_bytes:
                        raise OSError(f"received {partial.stat().st_size} of {found.size_bytes} bytes")
                    return found == about

                if asked(about.name, fetch):
                    partial.replace(place)
            finally:
                partial.unlink(missing_ok=True)

    def _make_room(self, about: StoredFile) -> None:
        """Remove the unused files that were read longest ago. Files in use or in transfer may exceed the limit."""
        if about.size_bytes > self._cache.most_bytes:
            raise ArchiveError(
                f"{about.name} has {about.size_bytes} bytes, more than the cache size of {self._cache.most_bytes} "
                f"in {self._cache.folder}; raise --cache-gb"
            )
        kept = []
        for place in self._cache.own.iterdir():
            try:
                kept.append((place.stat().st_mtime_ns, place.stat().st_size, place))
            except FileNotFoundError:  # removed by another
                continue
        total = sum(size for _, size, _ in kept)
        for _, size, place in sorted(kept):
            if total + about.size_bytes <= self._cache.most_bytes and place.suffix != _PARTIAL:
                continue
            if _removed(place):
                total -= size


def _held(place: Path, alone: bool = False) -> BinaryIO | None:
    """Return an open file that cannot be removed meanwhile; None: it is not, or no longer, the file of that name.
    `alone`: create it if missing, with an exclusive lock; also None if another process has it.
    """
    try:
        file = place.open("a+b" if alone else "rb")
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB if alone else fcntl.LOCK_SH)
        # Another process may have removed it before it was locked.
        if os.fstat(file.fileno()).st_ino == place.stat().st_ino:
            return file
    except (FileNotFoundError, BlockingIOError):
        pass
    except BaseException:
        file.close()
        raise
    file.close()
    return None


def _removed(place: Path) -> bool:
    """Remove a file unless it is in use; return whether it is gone."""
    try:
        with place.open("r+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            place.unlink(missing_ok=True)
    except FileNotFoundError:
        return True
    except BlockingIOError:
        return False
    return True


def asked(name: str, action: Callable[[], T]) -> T:
    """Return a store's answer, with retries. Raises ArchiveError if it failed too often, has no such name, or denies
    access; OSError if the local disk is full.
    """
    backoff = Backoff(FIRST_WAIT_S)
    for tried in range(1, TRIES + 1):
        try:
            return action()
        except (FileNotFoundError, PermissionError) as error:
            raise ArchiveError(f"{name}: {_words(error)}; check the address and the credentials") from error
        except Exception as error:  # of botocore, which has hundreds
            if isinstance(error, OSError) and error.errno in _OF_THE_DISK:
                raise
            if tried == TRIES:
                raise ArchiveError(
                    f"{name} cannot be read now ({_words(error)}, tried {TRIES} times); check the store and the "
                    "network, then run again"
                ) from error
            time.sleep(backoff.failed())
    raise AssertionError("the last try returns or raises")


def _fresh(store: Any, path: str) -> StoredFile:
    store.invalidate_cache()
    return _on_store(store, store.info(path))


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _store_of(url: str) -> tuple[Any, str]:
    if "::" in url:  # fsspec reads it as a chain of stores, so it would read another file
        raise ArchiveError(f"{url}: addresses with :: are not supported; rename it")
    try:
        store, path = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise ArchiveError(
            f"{url}: not a location of archives ({error}); give a folder, a file or s3://bucket/"
        ) from error
    return store, str(path)
