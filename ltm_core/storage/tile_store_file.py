"""Create, lock, open and check the SQLite file of a tile store, and record which frames it has counted."""

import contextlib
import fcntl
import os
import sqlite3
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.storage.disk_io import sync
from ltm_core.storage.tile_store_schema import FrameRecord, StoreSchema, compressed

APPLICATION_ID = 0x4C544D31  # "LTM1"
LAYOUT = 1
"""Version of the tables below (user_version of SQLite)."""
LARGEST_VALUE = 256 << 20
"""Maximum bytes of one value in the file; a tile has some hundred kilobytes."""
CHECKED_BYTES = 64 << 20
"""File size in bytes up to which a file is checked completely when it is opened; in larger ones, damage is found when
it is read."""

CACHE_KB = 256
"""Cache in KB for each connection, for the pages that each frame touches; it is full after the first tiles. SQLite's
default of 2 MB would fill over 16 hours without use, because written data is not read again."""

TABLES = """
CREATE TABLE description (content TEXT NOT NULL);
CREATE TABLE tiles (row INTEGER, col INTEGER, content BLOB NOT NULL, PRIMARY KEY (row, col));
CREATE TABLE sources (
    id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE,
    counted INTEGER NOT NULL DEFAULT 0, kept INTEGER NOT NULL DEFAULT 0, horizon_ns INTEGER NOT NULL DEFAULT -1);
CREATE TABLE frames (source INTEGER, stamp_ns INTEGER, PRIMARY KEY (source, stamp_ns)) WITHOUT ROWID;
CREATE TABLE waiting (
    number INTEGER PRIMARY KEY, source INTEGER NOT NULL, stamp_ns INTEGER NOT NULL, model TEXT NOT NULL,
    payload BLOB NOT NULL);
CREATE TABLE changes (
    number INTEGER PRIMARY KEY, layer TEXT NOT NULL, stamp_ns INTEGER NOT NULL, content BLOB NOT NULL);
CREATE TABLE touches (
    row INTEGER, col INTEGER, source INTEGER, model TEXT, frames INTEGER NOT NULL,
    first_ns INTEGER NOT NULL, last_ns INTEGER NOT NULL, PRIMARY KEY (row, col, source, model)) WITHOUT ROWID;
"""


def lock_store(path: Path) -> int:
    """Lock a store for writing until the descriptor is closed or the process ends."""
    name = path.with_name(path.name + ".lock")
    try:
        lock = os.open(name, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise StoreError(
            f"{path}: cannot write to the folder ({error.strerror}); check its owner and the disk"
        ) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise StoreError(f"{path}: another process writes this store; run one node on it") from error
    return lock


def create_store(path: Path, schema: StoreSchema) -> None:
    """Create an empty store, which gets its name only when it is complete."""
    partial = path.with_name(f".{path.name}.new")
    try:
        for leftover in (partial, *(partial.with_name(partial.name + end) for end in ("-wal", "-shm", "-journal"))):
            leftover.unlink(missing_ok=True)
        with named_errors(str(path)), contextlib.closing(sqlite3.connect(partial, isolation_level=None)) as db:
            db.execute("PRAGMA journal_mode = WAL")
            db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            db.execute(f"PRAGMA user_version = {LAYOUT}")
            db.executescript(TABLES)
            db.execute("INSERT INTO description VALUES (?)", (schema.described(),))
        partial.replace(path)
        sync(path.parent)  # the name, too, must survive a power cut
    except OSError as error:
        raise StoreError(f"{path}: cannot be created ({error.strerror}); check its folder and the disk") from error


def open_store(path: Path, read_only: bool) -> tuple[sqlite3.Connection, StoreSchema]:
    """Open a sound store; return the connection and its schema."""
    check_header(path, APPLICATION_ID, LAYOUT, "store")
    with named_errors(str(path)):
        db = sqlite3.connect(
            f"{path.resolve().as_uri()}?mode={'ro' if read_only else 'rw'}",
            uri=True,
            isolation_level=None,
            check_same_thread=False,
            timeout=5.0,
        )
        try:
            db.execute("PRAGMA synchronous = FULL")  # a commit outlives a power cut
            db.execute(f"PRAGMA cache_size = -{CACHE_KB}")
            db.execute("PRAGMA cell_size_check = ON")
            db.execute("PRAGMA secure_delete = OFF")  # else freeing pages takes as much room as writing them
            db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_VALUE)
            check_tables(db, path, TABLES)
            if path.stat().st_size <= CHECKED_BYTES:
                (verdict,) = db.execute("PRAGMA quick_check(1)").fetchone()
                if verdict != "ok":
                    raise ConfigError(f"{path}: the store is damaged ({verdict}); restore it from a copy")
            (described,) = db.execute("SELECT content FROM description").fetchone() or ("",)
            return db, StoreSchema.from_description(str(described), str(path))
        except BaseException:
            db.close()
            raise


def check_tables(db: sqlite3.Connection, path: Path, tables: str) -> None:
    """Check the tables: a view or a computed column instead of a table could run arbitrary code for hours. `tables`:
    the script that creates ours. Raises ConfigError."""
    query = "SELECT type, name, sql FROM sqlite_schema WHERE sql IS NOT NULL ORDER BY name"
    with contextlib.closing(sqlite3.connect(":memory:")) as ours:
        ours.executescript(tables)
        expected = ours.execute(query).fetchall()
    if (found := db.execute(query).fetchall()) != expected:
        names = ", ".join(f"{kind} {name!r:.40}" for kind, name, _ in set(found) ^ set(expected))
        raise ConfigError(f"{path}: the store is damaged: unexpected tables ({names}); restore it")


def check_header(path: Path, application: int, layout: int, what: str, begun: bool = False) -> None:
    """Check that a file is ours before SQLite opens and perhaps changes it. `begun`: it may also be missing or empty,
    or name no program yet, as until its first transaction is whole. Raises ConfigError, StoreError."""
    try:
        with path.open("rb") as file:
            header = file.read(100)
    except FileNotFoundError as error:
        if begun:
            return
        raise ConfigError(f"{path}: no such {what}") from error
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error.strerror})") from error
    if begun and not header:
        return
    program, stated = (int.from_bytes(header[place : place + 4], "big") for place in (68, 60))
    ours = (application, 0) if begun else (application,)
    if len(header) < 100 or not header.startswith(b"SQLite format 3\0") or program not in ours:
        raise ConfigError(f"{path}: not an LTM {what}; it was not changed. Move it away or name another place")
    if stated not in ((layout, 0) if begun else (layout,)):
        raise ConfigError(f"{path}: {what} of layout {stated}, this release reads {layout}; use that which wrote it")


@contextlib.contextmanager
def named_errors(name: str) -> Iterator[None]:
    """Convert SQLite's errors to ours, with the file's name and a remedy."""
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorname", "") or ""
        no_text = not code and isinstance(error, sqlite3.OperationalError)  # a text that is no UTF-8
        if no_text or code.startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB", "SQLITE_TOOBIG", "SQLITE_ERROR")):
            raise ConfigError(f"{name}: the store is damaged ({error}); restore it from a copy") from error
        if not isinstance(error, sqlite3.OperationalError):
            raise  # a bug, not the disk
        remedy = next((text for start, text in _REMEDIES.items() if code.startswith(start)), "see the error")
        raise StoreError(f"{name}: {error} ({code}); {remedy}") from error
    except UnicodeDecodeError as error:  # of SQLite's own words, which repeat a damaged name
        raise ConfigError(f"{name}: the store is damaged ({error}); restore it from a copy") from error


def checked_rows(
    db: sqlite3.Connection, name: str, query: str, values: Sequence[object], *types: type
) -> list[tuple[Any, ...]]:
    """Return the rows of a query. Raises ConfigError for a column of another type, because SQLite does not enforce
    types."""
    with named_errors(name):
        rows = db.execute(query, values).fetchall()
    for row in rows:
        if tuple(map(type, row)) != types:
            found = ", ".join(f"{value!r:.40}" for value in row)
            raise ConfigError(f"{name}: the store is damaged: a row contains {found}; restore it from a copy")
    return rows


def wants_room(error: StoreError) -> bool:
    """Return whether more disk space may help; a quota is reported as an input/output error."""
    code = getattr(error.__cause__, "sqlite_errorname", "") or ""
    return code.startswith(("SQLITE_FULL", "SQLITE_IOERR", "SQLITE_CANTOPEN"))


_REMEDIES = {
    "SQLITE_FULL": "free space on the disk",
    "SQLITE_READONLY": "make the file and its folder writable",
    "SQLITE_CANTOPEN": "make its folder writable, and free space on the disk",
    "SQLITE_BUSY": "another process uses it",
    "SQLITE_IOERR": "check the disk",
}


@contextlib.contextmanager
def transaction(db: sqlite3.Connection, name: str) -> Iterator[sqlite3.Connection]:
    """Run a transaction on `db`; its changes are written completely or not at all. Raises as `named_errors`."""
    with named_errors(name):
        db.execute("BEGIN IMMEDIATE")
        try:
            yield db
            db.execute("COMMIT")
        except BaseException:
            if db.in_transaction:
                db.execute("ROLLBACK")
            raise


KEPT_FRAMES = 1_000_000
"""Maximum number of stamps kept per source, some 30 MB and a year of a frame every 30 s; older frames are rejected,
because they may have been counted. A limit by age would reject a camera whose clock was once set to another year."""


def count_frames(db: sqlite3.Connection, name: str, frames: Sequence[FrameRecord], keep: bool) -> None:
    """Count frames within a transaction on the store `name`. `keep`: with payloads, until their tiles are written.

    Raises ValueError where a frame has been counted already, ConfigError where the store is damaged."""
    sources = {
        name: db.execute(
            "INSERT INTO sources (name, counted, kept) VALUES (?1, ?2, ?2) "
            "ON CONFLICT (name) DO UPDATE SET counted = counted + ?2, kept = kept + ?2 RETURNING id",
            (name, count),
        ).fetchone()[0]
        for name, count in Counter(frame.source for frame in frames).items()
    }
    for frame in frames:
        try:
            db.execute("INSERT INTO frames VALUES (?, ?)", (sources[frame.source], frame.stamp_ns))
        except sqlite3.IntegrityError as error:
            raise ValueError(f"frame {frame.stamp_ns} of {frame.source} was counted before") from error
    if keep:
        db.executemany(
            "INSERT INTO waiting (source, stamp_ns, model, payload) VALUES (?, ?, ?, ?)",
            (
                (sources[frame.source], frame.stamp_ns, frame.model, compressed(frame.payload))
                for frame in frames
                if frame.payload
            ),
        )
    # The frames of each tile, source and network have one row.
    db.executemany(
        "INSERT INTO touches VALUES (?1, ?2, ?3, ?4, 1, ?5, ?5) "
        "ON CONFLICT DO UPDATE SET frames = frames + 1, first_ns = min(first_ns, ?5), last_ns = max(last_ns, ?5)",
        [(*key, sources[frame.source], frame.model, frame.stamp_ns) for frame in frames for key in frame.tiles],
    )
    for source, number in sources.items():
        _forget(db, name, source, number)


def _forget(db: sqlite3.Connection, name: str, source: str, number: int) -> None:
    """Limit the stamps kept of a source to about the `KEPT_FRAMES` newest."""
    ((kept,),) = checked_rows(db, name, "SELECT kept FROM sources WHERE id = ?", (number,), int)
    spare = kept - KEPT_FRAMES
    if spare <= KEPT_FRAMES // 20:
        return
    query = "SELECT stamp_ns FROM frames WHERE source = ? ORDER BY stamp_ns LIMIT 1 OFFSET ?"
    found = checked_rows(db, name, query, (number, spare - 1), int)
    if not found:
        raise ConfigError(f"{name}: the store is damaged: {source} has no {spare} frames; restore it from a copy")
    ((horizon,),) = found
    db.execute("DELETE FROM frames WHERE source = ? AND stamp_ns <= ?", (number, horizon))
    db.execute("UPDATE sources SET kept = kept - ?, horizon_ns = ? WHERE id = ?", (spare, horizon, number))
