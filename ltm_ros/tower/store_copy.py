"""Control the service of a tower, and copy its stores before an upgrade.

Copies of a tower's stores, made before a release is changed, and what to do with them on the way back.

A release may move a store's schema forward, never back. On the way back the store is taken as it is where the schema is
still the one of the copy, so that no frame is lost; else the copy returns and the newer store is put aside.

Root does this in folders that the service's user owns, who reads what cameras send. So no link is followed there.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sqlite3
import stat
import subprocess  # nosec B404 # argument lists, no shell
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ltm_core.base.errors import LtmError, StoreError

UNIT = "ltm.service"
LOOK_S = 0.5


class ServiceError(LtmError):
    """A service that cannot be asked, stopped or started."""


@dataclass(frozen=True)
class ServiceState:
    ready: bool
    """All its nodes have been up since it was started."""
    failed: bool
    """It has ended by itself since it was started, whether it is started again or not."""
    said: str
    """Its own word, for a person."""


class Service(Protocol):
    """Start returns at once; `state` says how that goes. Stop kills what has not ended after `patience_s` seconds;
    None: after the time that the unit itself gives."""

    def stop(self, patience_s: float | None = None) -> None: ...

    def start(self) -> None: ...

    def state(self) -> ServiceState: ...


class SystemdService:
    """By systemctl, whose word on Type=notify is the service's own READY=1."""

    def stop(self, patience_s: float | None = None) -> None:
        if patience_s is not None:
            _systemctl("stop", "--no-block", UNIT)
            deadline = time.monotonic() + patience_s
            while self._runs() and time.monotonic() < deadline:
                time.sleep(LOOK_S)
            if self._runs():
                _systemctl("kill", "--signal=KILL", UNIT, check=False)
        _systemctl("stop", UNIT)  # returns once it has ended

    def _runs(self) -> bool:
        return _systemctl("show", UNIT, "--property=ActiveState", "--value").strip() not in ("inactive", "failed")

    def start(self) -> None:
        _systemctl("reset-failed", UNIT, check=False)  # also sets the number of restarts to 0
        _systemctl("start", "--no-block", UNIT)

    def state(self) -> ServiceState:
        names = ("ActiveState", "SubState", "NRestarts", "Result", "StatusText", "ExecMainStatus")
        said = _systemctl("show", UNIT, f"--property={','.join(names)}")
        fields = dict(line.partition("=")[::2] for line in said.splitlines())
        again = fields.get("SubState") == "auto-restart" or fields.get("NRestarts", "0") != "0"
        failed = again or fields.get("ActiveState") == "failed"
        text = fields.get("StatusText") or ""
        if failed:
            text = f"{fields.get('Result')}, exit code {fields.get('ExecMainStatus')}{f': {text}' if text else ''}"
        return ServiceState(fields.get("ActiveState") == "active" and not again, failed, text)


def _systemctl(*arguments: str, check: bool = True) -> str:
    try:
        ran = subprocess.run(  # nosec B603 B607 # no shell; root's own PATH
            ["systemctl", *arguments], capture_output=True, text=True, errors="replace", timeout=300
        )
    except (FileNotFoundError, subprocess.TimeoutExpired) as error:
        raise ServiceError(
            f"systemctl {' '.join(arguments)}: {error}: the tower's service runs under systemd"
        ) from error
    if check and ran.returncode:
        raise ServiceError(f"systemctl {' '.join(arguments)}: {ran.stderr.strip() or f'exit code {ran.returncode}'}")
    return ran.stdout


COPIES = 3
"""Of each kind that are kept, the newest."""
SUFFIXES = (".ltm", ".sqlite")
ROOM = 1.1
"""Times the stores' size that must be free."""


def copy_stores(state: Path, copies: Path, version: str) -> Path | None:
    """A folder below `copies` with every store of `state`, as the release `version` left them; None: there are none.

    Whole even where a store is written to meanwhile (SQLite's backup). Raises StoreError.
    """
    stores = stores_of(state)
    if not stores:
        return None
    try:
        _make_own(copies)
    except OSError as error:
        raise StoreError(f"{copies}: {error.strerror}; nothing was changed") from error
    size, free = sum(store.stat().st_size for store in stores), shutil.disk_usage(copies).free
    if free < ROOM * size:
        raise StoreError(
            f"{copies}: {free / 1e6:.0f} MB free, a copy of the stores takes {size / 1e6:.0f} MB: make room"
        )
    target = copies / f"{time.strftime('%Y%m%d-%H%M%S')}-{version}"
    partial = copies / ".partial"  # of one name, so that what a power cut leaves goes with the next copy
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    for store in stores:
        _backup(store, partial / store.name)
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
    """Put back the stores of `copy` whose schema has changed since; the newer ones go to the folder `aside`.

    Returns what was put back. Nothing may write the stores meanwhile. Raises StoreError that names those which could
    not be (no room, a copy that is damaged or gone); all others are back then.
    """
    if not copy.is_dir():
        raise StoreError(f"{copy}: the copy of the stores is not there")
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
            # Before the release is switched, on another disk perhaps: it must not find the newer store after a cut.
            for folder in (aside, state):
                _sync(folder)
        except OSError as error:
            failed.append(f"{store.name} ({error.strerror})")
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
    if failed:
        raise StoreError(f"{copy}: cannot be put back: {', '.join(failed)}")
    return changed


def schema_of(store: Path) -> tuple[int, tuple[str, ...]]:
    """SQLite's user_version, every table as it is declared, and what a map's store says of its tiles, whose fields may
    grow in tables that stay; (-1, ()) of what is no store any more."""
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


def _backup(store: Path, target: Path) -> None:
    try:
        with (
            contextlib.closing(sqlite3.connect(f"{store.resolve().as_uri()}?mode=ro", uri=True)) as source,
            contextlib.closing(sqlite3.connect(target)) as copy,
        ):
            source.backup(copy)
    except sqlite3.Error as error:
        raise StoreError(f"{store}: cannot be copied ({error}); nothing was changed") from error


def _make_own(folder: Path) -> None:
    """Raises OSError where it cannot be made, and where it is a link or somebody else's."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o750)
    stated = folder.lstat()
    if not stat.S_ISDIR(stated.st_mode) or stated.st_uid != os.geteuid():
        raise OSError(errno.EPERM, "a link, or a folder of somebody else's: move it away")


def _copy(store: Path, target: Path) -> None:
    """A file of its own, on the disk, with the store's owner and rights. Raises OSError."""
    target.unlink(missing_ok=True)
    descriptor = os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    with open(descriptor, "wb") as file, store.open("rb") as source:  # noqa: PTH123 # of a descriptor
        shutil.copyfileobj(source, file, 1 << 20)
        file.flush()
        stated = store.stat()
        if os.geteuid() == 0:
            os.fchown(descriptor, stated.st_uid, stated.st_gid)
        os.fchmod(descriptor, stated.st_mode & 0o7777)
        os.fsync(descriptor)


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _give_to_owner_of(store: Path, file: Path) -> None:
    stated = store.stat()
    if os.geteuid() == 0:
        os.chown(file, stated.st_uid, stated.st_gid)
    file.chmod(stated.st_mode & 0o7777)
