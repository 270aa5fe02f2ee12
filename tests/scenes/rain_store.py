"""A tile store of made-up rain, two by two tiles, for tests of the store itself."""

from pathlib import Path

import numpy as np

from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import CellChanges, Field, StoreSchema, Tile

GRID = GridGeometry(480_015.0, 4_150_915.0, 30.0, 21, 13, "EPSG:26911")
SCHEMA = StoreSchema("weather", 3, GRID, 8, {"rain": Field(np.float32, (4,)), "seen": Field(np.int64)})


def tile(seed: int) -> Tile:
    rng = np.random.default_rng(seed)
    return {"rain": rng.random((8, 8, 4), np.float32), "seen": rng.integers(-(2**60), 2**60, (8, 8))}


def changes(layer: str, stamp: int, cells: list[tuple[int, int, int, int]]) -> CellChanges:
    return CellChanges(layer, stamp, *np.array(cells, np.int32).reshape(-1, 4).T)


def read_whole(path: Path) -> list[Tile | None]:
    with TileStore.open(path, SCHEMA) as store:
        return [store.read(key) for key in [(0, 0), (0, 1), (1, 0), (1, 1)]]
