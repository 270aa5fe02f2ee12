"""Which frames a tile store has counted: each once, remembered so far back, and who has touched a tile."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from ltm_core.base.errors import ConfigError
from ltm_core.storage.tile_store_file import checked_rows
from ltm_core.storage.tile_store_schema import FrameRecord, compressed

KEPT_FRAMES = 20_000
"""Stamps remembered of each source at least, a week of a frame every 30 s; older ones are refused, as nobody knows."""
KEPT_NS = 7 * 86_400 * 10**9
"""Up to the newest, in which a source's stamps are remembered however many they are: thousands of one minute push out
none of the same day."""
MOST_FRAMES = 1_000_000
"""Stamps remembered of a source at most, some 30 MB: nobody shall fill the disk."""


@dataclass(frozen=True)
class Remembered:
    """How many stamps of a source are remembered: `frames` at least, those of `KEPT_NS` too, `most` at most."""

    frames: int = KEPT_FRAMES
    most: int = MOST_FRAMES


def count_frames(
    db: sqlite3.Connection, name: str, frames: Sequence[FrameRecord], keep: bool, bounds: Remembered
) -> None:
    """Within a transaction on the store `name`. `keep`: their payloads too, until the tiles that hold them are written.

    Raises ValueError where a frame has been counted already, ConfigError where the store is damaged.
    """
    _count(db, frames, keep)
    _touch(db, frames)
    for source in {frame.source for frame in frames}:
        _forget(db, name, source, bounds)


def _count(db: sqlite3.Connection, frames: Sequence[FrameRecord], keep: bool) -> None:
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
            raise ValueError(f"the frame {frame.stamp_ns} of {frame.source} has been counted already") from error
    if keep:
        db.executemany(
            "INSERT INTO waiting (source, stamp_ns, model, payload) VALUES (?, ?, ?, ?)",
            (
                (sources[frame.source], frame.stamp_ns, frame.model, compressed(frame.payload))
                for frame in frames
                if frame.payload
            ),
        )


def _touch(db: sqlite3.Connection, frames: Sequence[FrameRecord]) -> None:
    """One row for each tile, source and network, however many frames of a transaction there are."""
    touches: dict[tuple[int, int, str, str], tuple[int, int, int]] = {}
    for frame in frames:
        at = frame.stamp_ns
        for row, col in frame.tiles:
            key = row, col, frame.source, frame.model
            count, first, last = touches.get(key, (0, at, at))
            touches[key] = count + 1, min(first, at), max(last, at)
    db.executemany(
        "INSERT INTO touches SELECT ?, ?, id, ?, ?, ?, ? FROM sources WHERE name = ? "
        "ON CONFLICT DO UPDATE SET frames = frames + excluded.frames, "
        "first_ns = min(first_ns, excluded.first_ns), last_ns = max(last_ns, excluded.last_ns)",
        [(row, col, model, *touch, source) for (row, col, source, model), touch in touches.items()],
    )


def _forget(db: sqlite3.Connection, name: str, source: str, bounds: Remembered) -> None:
    """Bound what is remembered of a source: the newest `bounds.frames`, and those within `KEPT_NS` of the newest, up
    to `bounds.most`.

    Not by age alone: a camera whose clock was once set to another year shall neither be refused from then on nor
    be counted twice. Not by number alone: whoever sends many frames would make those that are late too old.
    """
    ((number, kept),) = checked_rows(db, name, "SELECT id, kept FROM sources WHERE name = ?", (source,), int, int)
    ((newest,),) = checked_rows(db, name, "SELECT max(stamp_ns) FROM frames WHERE source = ?", (number,), int)
    old = _old_among(db, number, kept - bounds.frames, newest - KEPT_NS, bounds.frames)
    spare = max(old, kept - bounds.most)
    if spare <= min(bounds.frames, bounds.most) // 20:
        return
    found = checked_rows(
        db,
        name,
        "SELECT stamp_ns FROM frames WHERE source = ? ORDER BY stamp_ns LIMIT 1 OFFSET ?",
        (number, spare - 1),
        int,
    )
    if not found:
        raise ConfigError(f"{name}: the store is damaged: {source} has no {spare} frames; restore it from a copy")
    ((horizon,),) = found
    db.execute("DELETE FROM frames WHERE source = ? AND stamp_ns <= ?", (number, horizon))
    db.execute("UPDATE sources SET kept = kept - ?, horizon_ns = ? WHERE id = ?", (spare, horizon, number))


def _old_among(db: sqlite3.Connection, number: int, spare: int, limit_ns: int, most: int) -> int:
    """How many of a source's `spare` oldest frames are older than that; counts at most `most`."""
    if spare <= 0:
        return 0
    (old,) = db.execute(
        "SELECT count(*) FROM (SELECT 1 FROM frames WHERE source = ? AND stamp_ns < ? LIMIT ?)",
        (number, limit_ns, min(spare, most)),
    ).fetchone()
    return int(old)
