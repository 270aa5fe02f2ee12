"""Readers of a map's store: SQLite's pages, and the rows in them."""

import random
import sqlite3
import struct
import tempfile
from pathlib import Path

import numpy as np
import zstandard
from scenes.small_site import write_small_site

from fuzz.mutations import spoil_bytes
from fuzz.target import Target
from ltm_core.fuel.votes import CellVotes
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_KIND, fuel_schema, open_stored_map, votes_to_bytes
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import CellChanges, FrameRecord
from ltm_core.vision.labels import LabelSet


def _stores(folder: Path) -> list[bytes]:
    small = write_small_site(folder, recording=False)
    geometry = small.site.fuel_geometry(small.dem)
    labels = LabelSet.load()
    evidence = site_evidence_map(small.site, geometry, labels)
    cells = np.arange(6, dtype=np.int32)
    counts = np.zeros((6, len(labels)), np.uint32)
    counts[:, 1] = 40
    votes = CellVotes(geometry, cells, cells + 1, counts, np.ones(6, np.float32), 10**18, "tower")
    window = evidence.add(votes)
    files = []
    for with_tiles in (True, False):
        path = folder / "made.ltm"
        path.unlink(missing_ok=True)
        tiles = evidence.tiles_of(window) if window is not None else ()
        with TileStore.open(path, fuel_schema(small.site, geometry)) as store:
            store.commit(
                {key: evidence.tile_state(key) for key in tiles} if with_tiles else {},
                [FrameRecord("tower", 10**18, ((0, 0),), "a network", votes_to_bytes(votes))],
                [CellChanges("code", 10**18, cells, cells, cells, cells + 100)],
            )
        database = sqlite3.connect(path)
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        database.execute("PRAGMA journal_mode = DELETE")
        database.execute("VACUUM")
        database.close()
        files.append(path.read_bytes())
    return files


def _read_store(folder: Path) -> None:
    path = folder / "fuel_map.ltm"
    for ending in ("-wal", "-shm", "-journal"):
        path.with_name(path.name + ending).unlink(missing_ok=True)
    with TileStore.open_read_only(path, STORE_KIND) as store:
        for _ in store.tiles():
            pass
        keys = store.keys()
        store.counted("tower", 5), store.forgotten("tower", 5), store.frame_count(), store.sources(), store.newest_ns()
        for key in keys:
            store.touches(key)
        list(store.changes("code"))
        store.waiting()
        if store.schema.geometry.width * store.schema.geometry.height < 1_000_000:
            store.as_of("code", np.zeros(store.schema.geometry.shape, np.int16), 2 * 10**18)
    site = load_site(folder / "site.yaml")
    empty = site_evidence_map(site, site.fuel_geometry(site.open_dem()), LabelSet.load())
    open_stored_map(path, site, empty).close()
    with TileStore.open(path, fuel_schema(site, empty.geometry)) as store:
        frame = FrameRecord("tower", 10**18 + 7, ((0, 0),), "a network", b"x")
        if not store.counted(frame.source, frame.stamp_ns):
            store.commit({}, [frame])


_ENDLESS = "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r)"
_FRAME_OF_2_45_BYTES = struct.pack("<IBQ", 0xFD2FB528, 0xE0, 1 << 45)
_ARRAY_OF_2_40_NUMBERS = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776,)}"
_VALUES: tuple[object, ...] = (
    *(None, "", "x", "\udc80", b"", b"\xff\xfe", -1, 0, 2**62, -(2**63), 1.5, float("inf"), "9" * 400, "[" * 5000),
    *(zstandard.compress(bytes(64 << 20)), zstandard.compress(b"x")[:6], _FRAME_OF_2_45_BYTES),
    *(zstandard.compress(_ARRAY_OF_2_40_NUMBERS), zstandard.compress(bytes(160)), zstandard.compress(b"\xff" * 160)),
    zstandard.ZstdCompressor(write_content_size=False).compress(bytes(160)),
)
_ORDERS = (
    "DROP TABLE frames",
    "DELETE FROM description",
    "CREATE TRIGGER t AFTER INSERT ON frames BEGIN DELETE FROM tiles; END",
    f"DROP TABLE tiles; CREATE VIEW tiles AS {_ENDLESS} SELECT n AS row, n AS col, x'' AS content FROM r",
    "DROP TABLE waiting; CREATE TABLE waiting (number, source, stamp_ns, model, payload AS (zeroblob(900000000)))",
    "PRAGMA user_version = 99",
    "PRAGMA application_id = 5",
    "INSERT INTO tiles VALUES (-1, 4000000000, x'00')",
    "INSERT INTO tiles SELECT row + 900, col + 900, content FROM tiles",
    "UPDATE sources SET id = NULL",
    "PRAGMA encoding = 'UTF-16'",
)


def _spoil_store(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    """Half of the cases are spoiled in their rows, so that the checks of SQLite's own pages find nothing."""
    if rng.random() < 0.5:
        return spoil_bytes(rng, data, seeds)
    with tempfile.NamedTemporaryFile(suffix=".ltm") as file:
        Path(file.name).write_bytes(data)
        database = sqlite3.connect(file.name, isolation_level=None)
        try:
            for _ in range(rng.choice((1, 1, 2, 4))):
                try:
                    _spoil_row(rng, database)
                except (sqlite3.Error, UnicodeEncodeError):
                    continue
        finally:
            database.close()
        return Path(file.name).read_bytes()


def _spoil_row(rng: random.Random, database: sqlite3.Connection) -> None:
    if rng.random() < 0.15:
        database.executescript(rng.choice(_ORDERS))
        return
    columns = {
        "description": ("content",), "tiles": ("row", "col", "content"), "frames": ("source", "stamp_ns"),
        "sources": ("id", "name", "counted", "kept", "horizon_ns"),
        "changes": ("number", "layer", "stamp_ns", "content"),
        "waiting": ("number", "source", "stamp_ns", "model", "payload"),
        "touches": ("row", "col", "source", "model", "frames", "first_ns", "last_ns"),
    }  # fmt: skip
    table = rng.choice(list(columns))
    column = rng.choice(columns[table])
    (found,) = database.execute(f"SELECT {column} FROM {table} LIMIT 1").fetchone() or (b"",)
    value = rng.choice(_VALUES)
    if isinstance(found, bytes) and rng.random() < 0.5:
        try:
            value = zstandard.compress(spoil_bytes(rng, zstandard.decompress(found), [found]))
        except (zstandard.ZstdError, MemoryError):  # an earlier round may have planted a frame that claims 2^45 bytes
            value = spoil_bytes(rng, found, [found])
    elif isinstance(found, str) and rng.random() < 0.6:
        value = spoil_bytes(rng, found.encode(), [found.encode()]).decode("utf-8", "replace")
    if isinstance(value, str) and "\udc80" in value:
        database.execute(f"UPDATE {table} SET {column} = CAST(x'ff80fe' AS TEXT)")
    else:
        database.execute(f"UPDATE {table} SET {column} = ?", (value,))


STORE_FILES = (Target("store", "fuel_map.ltm", _stores, _read_store, _spoil_store),)
