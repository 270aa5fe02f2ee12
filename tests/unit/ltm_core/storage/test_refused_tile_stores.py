import contextlib
import sqlite3
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from scenes.rain_store import GRID, SCHEMA, changes, read_whole, tile

from ltm_core.base.errors import ConfigError
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import Field, FrameRecord

_CLAIM = struct.pack("<IBQ", 0xFD2FB528, 0xE0, 1 << 45)


def foreign_database(path: Path) -> None:
    with sqlite3.connect(path) as db:
        db.execute("CREATE TABLE tiles (row, col, content)")
    db.close()


def later_layout(path: Path) -> None:
    TileStore.open(path, SCHEMA).close()
    with sqlite3.connect(path) as db:
        db.execute("PRAGMA user_version = 2")
    db.close()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"kind": "fuel"}, "kind is weather, here fuel"),
        ({"version": 4}, "version is 3, here 4"),
        ({"tile": 16}, "tile is 8, here 16"),
        ({"terms": "tree decays in 9 years"}, "terms is , here tree decays in 9 years"),
        ({"geometry": replace(GRID, x_min=480_045.0)}, "480015.0.*480045.0"),
        ({"geometry": replace(GRID, crs="EPSG:26910")}, "EPSG:26911.*EPSG:26910"),
        ({"fields": {"rain": Field(np.float64, (4,)), "seen": Field(np.int64)}}, "<f4.*<f8"),
    ],
)
def test_store_of_another_map_is_refused_and_left_alone(tmp_path: Path, change: dict[str, Any], complaint: str) -> None:
    path = tmp_path / "map.ltm"
    with TileStore.open(path, SCHEMA) as store:
        store.commit({(0, 0): tile(1)})
    before = path.read_bytes()
    with pytest.raises(ConfigError, match=complaint):
        TileStore.open(path, replace(SCHEMA, **change))
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda path: path.write_bytes(b""), "not an LTM store"),
        (lambda path: path.write_text("dear diary " * 50), "not an LTM store"),
        (foreign_database, "not an LTM store"),
        (later_layout, "layout 2, this release reads 1"),
    ],
)
def test_foreign_file_is_refused_and_left_alone(tmp_path: Path, make: Any, complaint: str) -> None:
    path = tmp_path / "map.ltm"
    make(path)
    before = path.read_bytes()
    for opening in (lambda: TileStore.open(path, SCHEMA), lambda: TileStore.open_read_only(path, "weather")):
        with pytest.raises(ConfigError, match=complaint):
            opening()
    assert path.read_bytes() == before


@pytest.mark.parametrize("where", ["first", "middle", "tail"])
def test_damaged_store_is_refused_and_left_alone(tmp_path: Path, where: str) -> None:
    path = tmp_path / "map.ltm"
    with TileStore.open(path, SCHEMA) as store:
        store.commit({key: tile(sum(key)) for key in ((0, 0), (0, 1), (1, 0), (1, 1))}, [FrameRecord("a", 1)])
    content = bytearray(path.read_bytes())
    if where == "tail":
        content = content[: len(content) // 2]
    else:
        at = 200 if where == "first" else len(content) // 2
        content[at : at + 3000] = np.random.default_rng(1).bytes(3000)
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="damaged"):
        read_whole(path)
    assert path.read_bytes() == bytes(content)


def spoiled(path: Path, order: str, *values: object) -> Path:
    """A store with content, in which somebody else has changed a row."""
    with TileStore.open(path, SCHEMA) as store:
        store.commit({(0, 1): tile(3)}, [FrameRecord("north", 5)], [changes("code", 5, [(1, 2, 0, 4)])])
        store.commit({}, [FrameRecord("north", 6, (), "a network", b"payload")])
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(order, values)
    return path


def read_all(path: Path) -> None:
    with TileStore.open_read_only(path, SCHEMA.kind) as store:
        list(store.tiles())
        list(store.changes("code"))
        store.waiting()
        store.sources()
        store.touches((0, 1))


@pytest.mark.parametrize(
    ("order", "values"),
    [
        ("UPDATE tiles SET content = ?", (_CLAIM,)),
        ("UPDATE tiles SET content = ?", (zstandard.compress(bytes(99)),)),
        ("UPDATE tiles SET content = ?", ("text",)),
        ("UPDATE tiles SET row = ?", (4_000_000_000,)),
        ("UPDATE tiles SET row = ?", ("x",)),
        ("UPDATE changes SET content = ?", (zstandard.compress(bytes(64 << 20)),)),
        ("UPDATE changes SET content = ?", (zstandard.compress(b"\xff" * 16),)),
        ("UPDATE changes SET content = ?", (zstandard.compress(bytes(15)),)),
        ("UPDATE waiting SET payload = ?", (_CLAIM,)),
        ("UPDATE waiting SET payload = ?", (zstandard.compress(bytes(64 << 20)),)),
        ("UPDATE waiting SET stamp_ns = ?", ("noon",)),
        ("UPDATE sources SET name = CAST(x'ff80fe' AS TEXT)", ()),
        ("UPDATE sources SET counted = ?", (b"many",)),
        ("UPDATE description SET content = CAST(x'ff80fe' AS TEXT)", ()),
        ("UPDATE description SET content = ?", ("[" * 5000,)),
        ("UPDATE description SET content = replace(content, '\"tile\": 8', '\"tile\": 100000')", ()),
        ("UPDATE description SET content = replace(content, '<i8', '|O')", ()),
        ("CREATE VIEW v AS WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT n FROM r", ()),
    ],
)
def test_rows_that_no_store_writes_are_refused(tmp_path: Path, order: str, values: tuple[object, ...]) -> None:
    path = spoiled(tmp_path / "store.ltm", order, *values)
    with pytest.raises(ConfigError, match=r"damaged|cannot be read"):
        read_all(path)


def test_a_frame_is_not_counted_in_a_store_that_contradicts_itself(tmp_path: Path) -> None:
    path = spoiled(tmp_path / "store.ltm", "UPDATE sources SET kept = 9000000000000000")
    with TileStore.open(path, SCHEMA) as store, pytest.raises(ConfigError, match="damaged"):
        store.commit({}, [FrameRecord("north", 9)])
