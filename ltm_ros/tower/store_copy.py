"""Control the service of a tower; copy its stores before an upgrade and return them after a failed one.

A release may migrate a store's schema forward, never back. On the way back, a store stays if its schema is still that
of the copy, so that no frame is lost; otherwise the copy returns and the newer store is moved aside.

Root does this in folders of the service's user, who processes data from cameras. So links are not followed there."""

import contextlib
import errno
import os
import shutil
import sqlite3
import stat
import time
from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import StoreError
from ltm_core.storage.disk_io import free_bytes, sync
from ltm_ros.tower.releases import program_output

UNIT = "ltm.service"


@dataclass(frozen=True)
class ServiceState:
    ready: bool
    """All its nodes have been ready since its start."""
    failed: bool
    """It has ended by itself since its start, whether or not it is restarted."""
    said: str
    """Status line of the service."""


class SystemdService:
    """Service control by systemctl; with Type=notify, ready means the service's READY=1."""

    def stop(self) -> None:
        """Stop the service; systemd kills what has not ended after the unit's own time."""
        program_output("systemctl", "stop", UNIT)

    def start(self) -> None:
        """Start the service and return at once; `state` reports progress."""
        program_output("systemctl", "reset-failed", UNIT, check=False)  # also resets the number of restarts
        program_output("systemctl", "start", "--no-block", UNIT)

    def state(self) -> ServiceState:
        names = ("ActiveState", "SubState", "NRestarts", "Result", "StatusText", "ExecMainStatus")
        said = program_output("systemctl", "show", UNIT, f"--property={','.join(names)}")
        fields = dict.fromkeys(names, "") | dict(line.partition("=")[::2] for line in said.splitlines())
        again = fields["SubState"] == "auto-restart" or fields["NRestarts"] not in ("", "0")
        failed = again or fields["ActiveState"] == "failed"
        text = fields["StatusText"]
        if failed:
            text = f"{fields['Result']}, exit code {fields['ExecMainStatus']}{f': {text}' if text else ''}"
        return ServiceState(fields["ActiveState"] == "active" and not again, failed, text)


COPIES = 3
"""Number of copies of each kind that are kept."""
SUFFIXES = (".ltm", ".sqlite")
ROOM = 1.1
"""Required free space, as a multiple of the stores' size."""


def copy_stores(state: Path, copies: Path, version: str) -> Path | None:
    """Copy every store of `state` to a new folder below `copies`; return it, None without stores.

    The copy is consistent even if a store is written meanwhile (SQLite's backup). Raises StoreError."""
    stores = stores_of(state)
    if not stores:
        return None
    try:
        _make_own(copies)
    except OSError as error:
        raise StoreError(f"{copies}: {error.strerror}; nothing was changed") from error
    size, free = sum(store.stat().st_size for store in stores), free_bytes(copies)
    if free < ROOM * size:
        raise StoreError(
            f"{copies}: {free / 1e6:.0f} MB free, a copy of the stores needs {size / 1e6:.0f} MB: free some space"
        )
    target = copies / f"{time.strftime('%Y%m%d-%H%M%S')}-{version}"
    partial = copies / ".partial"  # one name, so that the next copy replaces what a power cut leaves
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    for store in stores:
        try:
            with (
                contextlib.closing(sqlite3.connect(f"{store.resolve().as_uri()}?mode=ro", uri=True)) as source,
                contextlib.closing(sqlite3.connect(partial / store.name)) as copy,
            ):
                source.backup(copy)
        except sqlite3.Error as error:
            raise StoreError(f"{store}: cannot be copied ({error}); nothing was changed") from error
        _give_to_owner_of(store, partial / store.name)
    os.sync()
    partial.rename(target)
    for former in sorted(path for path in copies.iterdir() if path.name[:1] != ".")[:-COPIES]:
        shutil.rmtree(former, ignore_errors=True)
    return target


def stores_of(state: Path) -> list[Path]:
    if not state.is_dir():
        return []
    return sorted(path for path in state.iterdir() if path.suffix in SUFFIXES and path.is_file())


def return_stores(state: Path, copy: Path, aside: Path) -> list[Path]:
    """Put back the stores of `copy` whose schema has changed; newer stores go to the folder `aside`.

    Returns what was put back. The stores must not be written meanwhile. Raises StoreError with the stores that could
    not be restored (disk full, copy damaged or missing); all others are restored."""
    if not copy.is_dir():
        raise StoreError(f"{copy}: the copy of the stores does not exist")
    failed = []
    changed = [store for store in stores_of(copy) if schema_of(state / store.name) != schema_of(store)]
    for store in changed:
        partial = state / f".{store.name}.returned"
        try:
            _make_own(aside)
            for end in ("", "-wal", "-shm"):
                former = state / f"{store.name}{end}"
                if former.exists():
                    former.replace(aside / former.name)
            _copy(store, partial)
            partial.replace(state / store.name)
            # Synced before the release is switched: after a power cut it must not find the newer store.
            for folder in (aside, state):
                sync(folder)
        except OSError as error:
            failed.append(f"{store.name} ({error.strerror})")
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
    if failed:
        raise StoreError(f"{copy}: cannot restore {', '.join(failed)}")
    return changed


def schema_of(store: Path) -> tuple[int, tuple[str, ...]]:
    """Return SQLite's user_version, the declarations of all tables, and the description of a map's tiles; (-1, ()) for
    a file that is no store."""
    try:
        with contextlib.closing(sqlite3.connect(f"{store.resolve().as_uri()}?mode=ro", uri=True)) as db:
            (version,) = db.execute("PRAGMA user_version").fetchone()
            declared = db.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name").fetchall()
            schema = [sql for _, sql in declared]
            if "description" in dict(declared):
                schema += [content for (content,) in db.execute("SELECT content FROM description")]
            return int(version), tuple(map(str, schema))
    except sqlite3.Error:
        return -1, ()


def _make_own(folder: Path) -> None:
    """Make a folder of its own. Raises OSError if it cannot be made, or is a link or owned by another user."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o750)
    stated = folder.lstat()
    if not stat.S_ISDIR(stated.st_mode) or stated.st_uid != os.geteuid():
        raise OSError(errno.EPERM, "a link, or a folder of another user: move it away")


def _copy(store: Path, target: Path) -> None:
    """Copy to a new file, synced, with the store's owner and permissions. Raises OSError."""
    target.unlink(missing_ok=True)
    descriptor = os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    with open(descriptor, "wb") as file, store.open("rb") as source:  # noqa: PTH123 # of a descriptor
        shutil.copyfileobj(source, file, 1 << 20)
        file.flush()
        _give_to_owner_of(store, descriptor)
        os.fsync(descriptor)


def _give_to_owner_of(store: Path, file: Path | int) -> None:
    stated = store.stat()
    if os.geteuid() == 0:
        os.chown(file, stated.st_uid, stated.st_gid)
    os.chmod(file, stated.st_mode & 0o7777)  # noqa: PTH101 # of a descriptor, too
