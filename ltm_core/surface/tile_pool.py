"""Bounded pool of the surface map's tiles in memory; the other tiles wait in the tile store."""

from collections import OrderedDict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import Int32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.tile_store import Key, TileStore
from ltm_core.storage.tile_store_schema import CellChanges, FrameRecord, StoreSchema, Tile
from ltm_core.surface.cell_layout import CELL, CELLS, FIELDS, TILE, TileCells

KIND, VERSION = "terrain", 5
Window = tuple[int, int, int, int]
"""Row, column, height and width of a part of the grid."""


def schema_of(geometry: GridGeometry) -> StoreSchema:
    """Return the schema of a terrain's store; `geometry`: in the site's CRS."""
    return StoreSchema(KIND, VERSION, geometry, TILE, FIELDS)


class TilePool:
    """Tiles by key, at most `capacity` of them in memory; the longest unused makes room. `canopy_known`: whether a
    fresh cell's base is the reference itself. `frames`, `changes`: not in the store yet."""

    def __init__(self, store: TileStore, capacity: int, canopy_known: bool) -> None:
        self.store = store
        self.capacity = capacity
        self.slots = np.full(store.schema.tiles, -1, np.int32)
        self.cells = TileCells.empty(capacity)
        self.frames: list[FrameRecord] = []
        self.changes: list[CellChanges] = []
        self._fresh_base = np.float32(0.0 if canopy_known else np.nan)
        self._used: OrderedDict[Key, int] = OrderedDict()
        self._free = list(range(capacity - 1, -1, -1))
        self._stored = set(store.keys())
        self._dirty: set[Key] = set()

    @staticmethod
    def capacity_of(megabytes: float) -> int:
        """Return the number of tiles that fit; at least those whose changes are decided at once."""
        return max(64, int(megabytes * 2**20 / ((CELL.itemsize + 1) * CELLS)))

    @property
    def known_keys(self) -> list[Key]:
        """Return all stored or loaded tiles, in row-major order."""
        return sorted(self._stored | self._used.keys())

    @property
    def in_memory(self) -> int:
        return len(self._used)

    def places(self) -> Int32Array:
        """Slot, tile row and tile column of the tiles in memory, (N, 3) by slot."""
        found = sorted((slot, *key) for key, slot in self._used.items())
        return np.array(found, np.int32).reshape(-1, 3)

    def require(self, keys: Sequence[Key]) -> Int32Array:
        """Return slots of tiles, which are loaded into memory; no more than `capacity` at a time. Raises StoreError."""
        wanted = set(keys)
        for key in keys:
            if key in self._used:
                self._used.move_to_end(key)
                continue
            if not self._free:
                self._make_room(wanted)
            self._fill(key, self._free[-1])
            self._used[key] = self.slots[key] = self._free.pop()
        return np.array([self._used[key] for key in keys], np.int32)

    def peek(self, key: Key) -> Tile | None:
        """Return a read-only tile's arrays (TILE, TILE), in memory or stored; None for an unseen one."""
        slot = self._used.get(key)
        if slot is not None:
            return {name: self.cells.records[name][slot].reshape(TILE, TILE) for name in FIELDS}
        return self.store.read(key) if key in self._stored else None

    def mosaic(self, window: Window, names: Iterable[str]) -> dict[str, NDArray[Any]]:
        """Return fields of the cells of a window, (h, w) each, zero where unseen. The window may start anywhere."""
        row, col, height, width = window
        parts = {name: np.zeros((height, width), CELL[name]) for name in names}
        for tile_row in range(row // TILE, (row + height - 1) // TILE + 1):
            for tile_col in range(col // TILE, (col + width - 1) // TILE + 1):
                tile = self.peek((tile_row, tile_col))
                if tile is None:
                    continue
                r, c = tile_row * TILE - row, tile_col * TILE - col
                there = slice(max(r, 0), r + TILE), slice(max(c, 0), c + TILE)
                for name, part in parts.items():
                    inside = part[there]
                    down, right = max(-r, 0), max(-c, 0)
                    inside[:] = tile[name][down : down + inside.shape[0], right : right + inside.shape[1]]
        return parts

    def touched(self, keys: Iterable[Key]) -> None:
        """Mark these tiles, which are in memory, as changed."""
        self._dirty.update(keys)

    def counted(self, source: str, stamp_ns: int) -> bool:
        """Return whether a frame has been counted, written or not."""
        waiting = any(f.source == source and f.stamp_ns == stamp_ns for f in self.frames)
        return waiting or self.store.counted(source, stamp_ns)

    def commit(self, last: bool = False) -> int:
        """Write all that has changed, with the frames that did it, in one transaction; how many tiles. Raises
        StoreError, and then nothing is lost: call it again. `last`: before the store is closed."""
        if not self._dirty and not self.frames:
            return 0
        tiles = {key: tile for key in self._dirty if (tile := self.peek(key)) is not None}
        self.store.commit(tiles, self.frames, self.changes, last)
        self._stored |= tiles.keys()
        self._dirty.clear()
        self.frames, self.changes = [], []
        return len(tiles)

    def _make_room(self, wanted: set[Key]) -> None:
        oldest = next(key for key in self._used if key not in wanted)
        if oldest in self._dirty:
            self.commit()
        self._free.append(self._used.pop(oldest))
        self.slots[oldest] = -1

    def _fill(self, key: Key, slot: int) -> None:
        stored = self.store.read(key) if key in self._stored else None
        records = self.cells.records[slot]
        records[:] = 0
        records["base"] = self._fresh_base
        for name, values in (stored or {}).items():
            records[name] = values.ravel()
        self.cells.high[slot] = stored is not None
