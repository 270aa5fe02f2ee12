"""Check disk space and output paths before and while files are written."""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ltm_core.base.errors import ConfigError

is_file, is_folder, is_there = os.path.isfile, os.path.isdir, os.path.exists
"""Return whether a file, a folder, or anything exists; False also for invalid names and unreadable places, for which
`Path.is_file` raises OSError until Python 3.14."""


def folder_that_exists(path: Path) -> Path:
    """Return the path, or its nearest existing parent folder, for querying the disk before writing."""
    path = path.absolute()
    while not is_there(path) and path != path.parent:
        path = path.parent
    return path


def make_folder(folder: Path) -> None:
    """Make a folder where only it is missing, so that a disk that is not there is noticed. Raises ConfigError."""
    try:
        folder.mkdir(exist_ok=True)
    except FileNotFoundError as error:
        raise ConfigError(f"{folder}: the folder {folder.parent} does not exist; create it first") from error
    except OSError as error:
        raise ConfigError(f"{folder}: not a usable folder ({error.strerror})") from error


def sync(path: Path) -> None:
    """Write a file's content, or a folder's names, to the disk, so that they outlive a power cut. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def free_bytes(path: Path) -> int:
    """Return the bytes available on the file system of `path`, which need not exist yet. Raises OSError."""
    return shutil.disk_usage(folder_that_exists(path)).free


class DiskReserve:
    """Space on a disk, reserved by a file that is released when the disk is full.

    Whoever fills the disk can then not keep us from one last write. Not safe against others once it is given up."""

    def __init__(self, path: Path) -> None:
        """Nothing is held yet."""
        self.path = path
        self.most = 0
        """Maximum number of bytes held so far."""

    @property
    def held(self) -> int:
        """Return the bytes currently reserved."""
        try:
            return self.path.stat().st_blocks * 512
        except OSError:
            return 0

    def hold(self, wanted: int) -> None:
        """Reserve bytes, at most a quarter of the free space; on a full disk reserve nothing, without an error."""
        held = self.held
        try:
            size = min(wanted, (held + free_bytes(self.path)) // 4)
            if size > held:
                self._grow(size)
        except OSError:
            if not held:
                self.give_up()
        self.most = max(self.most, self.held)

    def _grow(self, size: int) -> None:
        descriptor = os.open(self.path, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            os.posix_fallocate(descriptor, 0, size)
        finally:
            os.close(descriptor)

    @contextmanager
    def lent(self) -> Iterator[None]:
        """Release the reserve to the caller, and reserve again what remains afterwards."""
        held = self.held
        self.give_up()
        try:
            yield
        finally:
            with suppress(OSError):
                self._grow(min(held, free_bytes(self.path) * 15 // 16))

    def give_up(self) -> None:
        """Release the reserve."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give the name of a file beside `path` which replaces it at the end of the block: it appears whole or not at all.

    Raises ConfigError if it cannot be written."""
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    except OSError as error:  # rasterio's own errors of opening a file among them
        raise ConfigError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        partial.unlink(missing_ok=True)


def require_folder(folder: Path, what: str = "results") -> None:
    """Raise ConfigError unless files can be written to `folder`, which need not exist; creates nothing."""
    reason = _why_not_into(folder)
    if reason is not None:
        raise ConfigError(f"{folder}: cannot write {what} ({reason}): name another folder")


def require_files(files: Iterable[Path], overwrite: bool = True, what: str = "results") -> None:
    """Raise ConfigError unless each of `files` can be written; creates missing folders.

    `overwrite`: whether files may be there already. Makes and changes nothing."""
    for file in files:
        if is_folder(file):
            raise ConfigError(f"{file}: is a folder; give a file name for {what}")
        if is_there(file) and not overwrite:
            raise ConfigError(f"{file}: exists already; name another file, or replace it with --overwrite")
        if is_there(file):
            reason = _why_not(lambda path: os.close(os.open(path, os.O_WRONLY)), file)
        else:
            reason = _why_not_into(file.parent) or _why_not(Path.exists, file)  # raises for a name that is too long
        if reason is not None:
            raise ConfigError(f"{file}: cannot write {what} ({reason}): name another file")


def _why_not_into(folder: Path) -> str | None:
    """Tried, not asked: permission bits say nothing to root, and of a file system that is read-only."""
    there = folder_that_exists(folder.expanduser())
    if not is_folder(there):
        return f"{there} is not a folder"
    return _why_not(lambda path: tempfile.TemporaryFile(dir=path).close(), there) or _why_not(Path.exists, folder)


def _why_not(attempt: Callable[[Path], object], path: Path) -> str | None:
    try:
        attempt(path)
    except OSError as error:
        return error.strerror or str(error)
    return None
