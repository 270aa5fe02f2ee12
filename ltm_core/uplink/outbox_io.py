"""Store the votes that a tower has not yet delivered in SQLite, and thin the oldest when the store is full.

A frame that `put` has returned from is in the file, also after a power cut, and stays until it is acknowledged, is too
old, or is thinned: every other frame of each view in the older half goes, so that the first of each view stays."""

import os
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.storage.tile_store_file import (
    LARGEST_VALUE,
    check_header,
    check_tables,
    lock_store,
    named_errors,
    transaction,
)

APPLICATION_ID: Final = 0x4C544D42  # "LTMB"
LAYOUT: Final = 1
FREED_SHARE: Final = 0.1
"""Share of the outbox's bytes freed at once when it is full."""
LARGEST_FRAME: Final = 1 << 20
"""Maximum bytes of one frame; votes have at most 64 kB."""

_EVERY_OTHER: Final = """
SELECT camera, stamp_ns FROM (
    SELECT camera, stamp_ns, row_number() OVER (PARTITION BY camera, view ORDER BY stamp_ns) AS number
    FROM (SELECT camera, stamp_ns, view FROM frames ORDER BY stamp_ns LIMIT ?)
) WHERE number % 2 = 0
"""
"""The second, fourth, ... frame of each view, among the oldest frames."""
_TABLE: Final = """
CREATE TABLE frames (
    camera TEXT NOT NULL, stamp_ns INTEGER NOT NULL, view INTEGER NOT NULL, model TEXT NOT NULL,
    message BLOB NOT NULL, retry_s REAL NOT NULL DEFAULT 0, PRIMARY KEY (camera, stamp_ns)) STRICT;
CREATE INDEX by_time ON frames (stamp_ns, retry_s);
"""
FrameKey = tuple[str, int]
"""Key of a frame: (camera, stamp in nanoseconds)."""


@dataclass(frozen=True)
class OutboxFrame:
    """Votes of one frame. `view`: number of the camera's viewing direction. `model`: label network, empty if unknown.
    `message`: serialised votes."""

    camera: str
    stamp_ns: int
    view: int
    model: str
    message: bytes = field(repr=False)


class Outbox:
    """Outbox file, opened by one process at a time. Methods raise StoreError for temporary disk errors (the call had no
    effect and may be repeated); ConfigError if the file is damaged: the next process that opens it moves it away.
    `path`: its folder must exist. `max_bytes`: of all messages together. `max_age_s`: seconds from a frame's stamp
    on."""

    def __init__(self, path: Path | str, max_bytes: int, max_age_s: float) -> None:
        """Raise StoreError as above, ConfigError where the folder is missing or the file is another program's."""
        self._path = Path(path)
        self._max_bytes, self._max_age_ns = max_bytes, round(max_age_s * 1e9)
        self.damage = ""
        """Description of the damage if a damaged file was moved away and a new one created."""
        if not self._path.parent.is_dir():
            raise ConfigError(f"{self._path}: the folder {self._path.parent} does not exist; create it first")
        self._lock = lock_store(self._path)
        try:
            self._db = self._opened()
            # Pauses are counted by the clock of a process that is gone.
            self._rows("UPDATE frames SET retry_s = 0 WHERE retry_s > 0")
            ((self.frames, self.bytes),) = self._rows("SELECT count(*), coalesce(sum(length(message)), 0) FROM frames")
            """Number of queued frames, and the bytes of their messages."""
        except BaseException:
            os.close(self._lock)
            raise

    def close(self) -> None:
        self._db.close()
        os.close(self._lock)

    def put(self, frames: Sequence[OutboxFrame]) -> int:
        """Keep frames, all of them or none; how many were not there yet. The first of a key stays."""
        new, size = 0, 0
        with transaction(self._db, str(self._path)) as db:
            for frame in frames:
                if len(frame.message) > LARGEST_FRAME:
                    raise ValueError(f"a frame of {len(frame.message)} bytes; the limit is {LARGEST_FRAME}")
                row = (frame.camera, frame.stamp_ns, frame.view, frame.model, frame.message)
                if db.execute("INSERT OR IGNORE INTO frames VALUES (?, ?, ?, ?, ?, 0)", row).rowcount:
                    new, size = new + 1, size + len(frame.message)
        self.frames, self.bytes = self.frames + new, self.bytes + size
        return new

    def waiting(self, limit: int, now_s: float, without: Iterable[FrameKey] = ()) -> list[tuple[FrameKey, int]]:
        """Return the newest queued frames, except these and those that `postpone` delays until after `now_s`, and the
        bytes of their messages. A current map has priority, and evidence may arrive in any order. `frame` reads the
        content of those that are sent."""
        left_out = set(without)
        query = "SELECT camera, stamp_ns, length(message) FROM frames WHERE retry_s <= ? ORDER BY stamp_ns DESC LIMIT ?"
        rows = self._rows(query, now_s, limit + len(left_out))
        return [((camera, at), size) for camera, at, size in rows if (camera, at) not in left_out][:limit]

    def frame(self, key: FrameKey) -> OutboxFrame | None:
        """Return the queued frame of a key; None: none."""
        query = "SELECT camera, stamp_ns, view, model, message FROM frames WHERE camera = ? AND stamp_ns = ?"
        return next((OutboxFrame(*row) for row in self._rows(query, *key)), None)

    def acknowledge(self, keys: Iterable[FrameKey]) -> int:
        """Remove frames that are in the region's map; return the number found."""
        return self._remove(list(keys))

    def postpone(self, keys: Iterable[FrameKey], until_s: float) -> None:
        """Delay sending frames until then, by the clock of `waiting`."""
        with transaction(self._db, str(self._path)) as db:
            db.executemany(
                "UPDATE frames SET retry_s = ? WHERE camera = ? AND stamp_ns = ?", [(until_s, *key) for key in keys]
            )

    def oldest_ns(self) -> int | None:
        """Return the stamp of the oldest frame; None: the queue is empty."""
        ((oldest,),) = self._rows("SELECT min(stamp_ns) FROM frames")
        return None if oldest is None else int(oldest)

    def bound(self, now_ns: int | None) -> tuple[int, int]:
        """Remove what is too old at `now_ns` (None: not known, so nothing is), and thin what is too much; return the
        number of frames that were too old, and too many."""
        aged = 0
        if now_ns is not None:
            old = self._rows("SELECT camera, stamp_ns FROM frames WHERE stamp_ns < ?", now_ns - self._max_age_ns)
            aged = self._remove(old)
        before, full = self.frames, self.bytes > self._max_bytes
        while full and self.bytes > (1 - FREED_SHARE) * self._max_bytes:
            # Of the older half, else of all; where one frame of each view is left, the oldest twentieth goes.
            queries = (
                (_EVERY_OTHER, (self.frames + 1) // 2),
                (_EVERY_OTHER, self.frames),
                ("SELECT camera, stamp_ns FROM frames ORDER BY stamp_ns LIMIT ?", 1 + self.frames // 20),
            )
            self._remove(next(filter(None, (self._rows(query, number) for query, number in queries))))
        return aged, before - self.frames

    def _rows(self, query: str, *values: object) -> list[Any]:
        with named_errors(str(self._path)):
            return self._db.execute(query, values).fetchall()

    def _remove(self, keys: Sequence[FrameKey]) -> int:
        if not keys:
            return 0
        frames, size = 0, 0
        with transaction(self._db, str(self._path)) as db:
            for key in keys:
                found = db.execute(
                    "DELETE FROM frames WHERE camera = ? AND stamp_ns = ? RETURNING length(message)", key
                ).fetchall()
                frames, size = frames + len(found), size + sum(int(row[0]) for row in found)
        self.frames, self.bytes = self.frames - frames, self.bytes - size
        return frames

    def _opened(self) -> sqlite3.Connection:
        """Return a sound database; a damaged one is put aside, for what it held cannot be sent."""
        check_header(self._path, APPLICATION_ID, LAYOUT, "outbox", begun=True)
        try:
            return _connect(self._path)
        except ConfigError as error:
            aside = self._path.with_name(f"{self._path.name}.damaged")  # the last one, for inspection
            try:
                for end in ("-wal", "-shm"):
                    self._path.with_name(self._path.name + end).unlink(missing_ok=True)
                self._path.replace(aside)
            except OSError as failed:
                raise StoreError(f"{self._path}: cannot be moved away ({failed.strerror}); check the disk") from failed
            self.damage = f"{error}; it was moved to {aside}; its queued frames were not sent. A new outbox was created"
            return _connect(self._path)


def _connect(path: Path) -> sqlite3.Connection:
    """Open an outbox, or make a new one. Raises ConfigError for a damaged file, StoreError."""
    with named_errors(str(path)):
        db = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=5.0)
        try:
            db.execute("PRAGMA journal_mode = WAL")
            db.execute("PRAGMA synchronous = FULL")  # what `put` has returned from outlives a power cut
            db.execute("PRAGMA secure_delete = OFF")  # else freeing pages takes as much room as writing them
            db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_VALUE)
            if db.execute("PRAGMA user_version").fetchone() == (0,):
                marks = f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {LAYOUT};"
                db.executescript(f"BEGIN IMMEDIATE; {_TABLE} {marks} COMMIT;")
            check_tables(db, path, _TABLE)
            (verdict,) = db.execute("PRAGMA integrity_check(1)").fetchone()
            if verdict != "ok":
                raise ConfigError(f"{path}: the outbox is damaged ({verdict})")
        except BaseException:
            db.close()
            raise
    return db
