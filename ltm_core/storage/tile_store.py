"""SQLite file with the state of a map: tiles of arrays, the frames counted in them, and a journal of changes.

The nodes `fuel_map` and `terrain` keep their maps in it. A transaction is in the file whole or not at all, also after a
power cut: what `commit` has returned from is kept. Frames may be committed before the tiles that hold their effect:
their payloads wait in the file, as in a redo log, so that a frame costs a small write, and the tiles are written now
and then."""

import contextlib
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from math import prod
from pathlib import Path
from typing import Any, Self

from numpy.typing import NDArray

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.storage.disk_io import DiskReserve
from ltm_core.storage.tile_store_file import (
    TABLES,
    checked_rows,
    count_frames,
    create_store,
    lock_store,
    open_store,
    transaction,
    wants_room,
)
from ltm_core.storage.tile_store_schema import (
    CellChanges,
    Field,
    FrameRecord,
    Key,
    StoreSchema,
    Tile,
    Touch,
    decompressed,
)

__all__ = ["CellChanges", "Field", "FrameRecord", "Key", "StoreSchema", "Tile", "TileStore", "Touch"]

RESERVE_BYTES = 32 << 20
"""Bytes reserved on the disk for transactions when it is full; at least twice the store's size."""
WAITING_CELL_BYTES, WAITING_HEADER_BYTES = 512, 64 << 10
"""Maximum bytes of a waiting frame, for each cell of the grid and in addition."""


class TileStore:
    """Open one with `open`, `open_read_only` or `in_memory`. One writer at a time, any number of readers beside it.

    A store that is written holds some room on its disk. On a full one a transaction is made in that room, which then
    is reserved again if it is left; its second half is for the last transaction alone (`commit`, `last`).

    Every method raises StoreError where the file cannot be read or written just now (then nothing of that call is in
    it, and the call may be made again), and ConfigError where its content is damaged."""

    def __init__(
        self,
        database: sqlite3.Connection,
        schema: StoreSchema,
        name: str,
        lock: int | None,
        reserve: DiskReserve | None = None,
    ) -> None:
        self.schema = schema
        self._db, self._name, self._lock, self._reserve = database, name, lock, reserve
        self._rows = partial(checked_rows, database, name)
        self.strain = ""
        """Description of a full disk at the last commit, in words."""

    @classmethod
    def open(cls, path: Path | str, schema: StoreSchema) -> "TileStore":
        """Open the store at `path`, created if missing, for exclusive writing by this process.

        Raises ConfigError for a file that is no store, is damaged, or was made for other content or another grid: such
        a file is not changed. Raises StoreError where another process writes it, the folder cannot be written or the
        disk is full."""
        path = Path(path)
        if not path.parent.is_dir():
            raise ConfigError(f"{path}: the folder {path.parent} does not exist; create it first")
        lock = lock_store(path)
        try:
            if not path.exists():
                create_store(path, schema)
            database, stored = open_store(path, read_only=False)
            if differences := schema.differences(stored):
                database.close()
                raise ConfigError(f"{path}: not a store of this map: {differences}; move it away or name another file")
            store = cls(database, schema, str(path), lock, DiskReserve(path.with_name(f".{path.name}.reserve")))
            store._hold()
            return store
        except BaseException:
            os.close(lock)
            raise

    @classmethod
    def open_read_only(cls, path: Path | str, kind: str) -> "TileStore":
        """Open a store of that kind read-only, with its own schema, also while another process writes it.

        Raises ConfigError and StoreError as `open` does."""
        path = Path(path)
        database, schema = open_store(path, read_only=True)
        if schema.kind != kind:
            database.close()
            raise ConfigError(f"{path}: contains {schema.kind}, not {kind}")
        return cls(database, schema, str(path), None)

    @classmethod
    def in_memory(cls, schema: StoreSchema) -> "TileStore":
        """Return a store in memory."""
        database = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
        database.executescript(TABLES)
        return cls(database, schema, "memory", None)

    def close(self) -> None:
        """Close the store. Idempotent."""
        self._db.close()
        if self._reserve is not None:
            self._reserve.give_up()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def keys(self) -> list[Key]:
        """Return the stored tiles' keys in row-major order."""
        keys = self._rows("SELECT row, col FROM tiles ORDER BY row, col", (), int, int)
        down, across = self.schema.tiles
        for row, col in keys:
            if not (0 <= row < down and 0 <= col < across):
                raise ConfigError(f"{self._name}: the store is damaged: tile {row, col} of {down, across}; restore it")
        return [(row, col) for row, col in keys]

    def read(self, key: Key) -> Tile | None:
        """Return a tile's arrays, (tile, tile, *shape of the field) each; None if it has not been written."""
        rows = self._rows("SELECT content FROM tiles WHERE row = ? AND col = ?", key, bytes)
        return self.schema.unpack(rows[0][0]) if rows else None

    def tiles(self) -> Iterator[tuple[Key, Tile]]:
        """Return all tiles, one at a time."""
        for key in self.keys():
            tile = self.read(key)
            if tile is not None:
                yield key, tile

    def counted(self, source: str, stamp_ns: int) -> bool:
        """Return whether a frame must not be counted, because it was counted or is too old to know (see
        `forgotten`)."""
        found = self._rows(
            "SELECT ?2 <= horizon_ns OR EXISTS(SELECT 1 FROM frames WHERE source = id AND stamp_ns = ?2) "
            "FROM sources WHERE name = ?1",
            (source, stamp_ns),
            int,
        )
        return bool(found and found[0][0])

    def forgotten(self, source: str, stamp_ns: int) -> bool:
        """Return whether a frame is older than the stamps kept for its source."""
        found = self._rows("SELECT horizon_ns FROM sources WHERE name = ?", (source,), int)
        return bool(found and stamp_ns <= found[0][0])

    def frame_count(self) -> int:
        """Return the number of frames counted since the store was created, of all sources."""
        return int(self._rows("SELECT coalesce(sum(counted), 0) FROM sources", (), int)[0][0])

    def sources(self) -> dict[str, int]:
        """Return the number of frames counted of each source."""
        return dict(self._rows("SELECT name, counted FROM sources ORDER BY name", (), str, int))

    def newest_ns(self) -> int | None:
        """Return the latest known stamp; None if no frame has been counted."""
        found = self._rows(
            "SELECT newest FROM "
            "(SELECT max((SELECT max(stamp_ns) FROM frames WHERE source = id)) AS newest FROM sources) "
            "WHERE newest IS NOT NULL",
            (),
            int,
        )
        return int(found[0][0]) if found else None

    def touches(self, key: Key) -> list[Touch]:
        """Return the sources and networks that have touched a tile."""
        found = self._rows(
            "SELECT name, model, frames, first_ns, last_ns FROM touches JOIN sources ON source = id "
            "WHERE row = ? AND col = ? ORDER BY name, model",
            key,
            *(str, str, int, int, int),
        )
        return [Touch(*row) for row in found]

    def waiting(self) -> list[FrameRecord]:
        """Return frames that are counted but not in a tile yet, with their payloads, in the order of their commits."""
        found = self._rows(
            "SELECT name, stamp_ns, model, payload FROM waiting JOIN sources ON source = id ORDER BY number",
            (),
            *(str, int, str, bytes),
        )
        most = prod(self.schema.geometry.shape) * WAITING_CELL_BYTES + WAITING_HEADER_BYTES
        return [FrameRecord(name, at, (), model, decompressed(payload, most)) for name, at, model, payload in found]

    def changes(self, layer: str, until_ns: int | None = None) -> Iterator[CellChanges]:
        """Return the journal of a layer in the order of its commits; only changes by frames up to `until_ns`."""
        limit = 2**63 - 1 if until_ns is None else until_ns
        found = self._rows(
            "SELECT stamp_ns, content FROM changes WHERE layer = ? AND stamp_ns <= ? ORDER BY number",
            (layer, limit),
            *(int, bytes),
        )
        return (CellChanges.unpack(layer, at, content, self.schema.geometry.shape) for at, content in found)

    def as_of(self, layer: str, initial: NDArray[Any], until_ns: int) -> NDArray[Any]:
        """Return a layer as of the frames up to `until_ns`; `initial`: (H, W), its state before the first."""
        if initial.shape != self.schema.geometry.shape:
            raise ValueError(f"initial layer of {initial.shape}, the grid is {self.schema.geometry.shape}")
        result = initial.copy()
        for change in self.changes(layer, until_ns):
            result[change.rows, change.cols] = change.new
        return result

    def commit(
        self,
        tiles: Mapping[Key, Mapping[str, NDArray[Any]]] | None = None,
        frames: Sequence[FrameRecord] = (),
        changes: Sequence[CellChanges] = (),
        last: bool = False,
    ) -> None:
        """Write all of it in one transaction, or nothing. `last`: before the store is closed.

        Where tiles are given, they hold the effect of all frames until now, these among them: no payload waits any
        longer. Raises ValueError where a frame has been counted already or a tile does not fit the schema."""
        packed = [(*key, self.schema.pack(key, arrays)) for key, arrays in (tiles or {}).items()]
        try:
            self._write(packed, frames, changes)
        except StoreError as error:
            reserve = self._reserve
            if reserve is None or not wants_room(error) or reserve.held <= (0 if last else reserve.most // 2):
                raise
            with reserve.lent():
                try:
                    self._write(packed, frames, changes)
                finally:
                    # What the transaction took beside the file is free again for the next.
                    with contextlib.suppress(sqlite3.Error):
                        self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            self.strain = f"{error}; this was written to reserved space, {reserve.held >> 10} kB are left"
        else:
            self.strain = ""
            self._hold()

    def _hold(self) -> None:
        """Half of the reserve is for the last transaction, which may write every tile once more."""
        if self._reserve is not None:
            with contextlib.suppress(OSError):
                self._reserve.hold(max(RESERVE_BYTES, 2 * Path(self._name).stat().st_size))

    def _write(
        self, packed: Sequence[tuple[int, int, bytes]], frames: Sequence[FrameRecord], changes: Sequence[CellChanges]
    ) -> None:
        with transaction(self._db, self._name) as db:
            count_frames(db, self._name, frames, not packed)
            db.executemany(
                "INSERT INTO changes (layer, stamp_ns, content) VALUES (?, ?, ?)",
                [(c.layer, c.stamp_ns, c.pack()) for c in changes if len(c.rows)],
            )
            if packed:
                db.executemany("INSERT OR REPLACE INTO tiles VALUES (?, ?, ?)", packed)
                db.execute("DELETE FROM waiting")
