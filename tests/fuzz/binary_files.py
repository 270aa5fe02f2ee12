"""Readers of files that are no text: photos, rasters, stores, bags, networks, arrays."""

from __future__ import annotations

import hashlib
import io
import random
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import rasterio
import yaml
import zstandard
from PIL import Image
from scenes.networks import HEIGHT, WIDTH, write_classifier
from scenes.rasters import rough_terrain
from scenes.small_site import write_small_site

from fuzz.mutations import spoil_bytes
from fuzz.target import Target
from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.errors import ConfigError
from ltm_core.evaluation.depth.depth_maps_io import DepthMapFolder
from ltm_core.fuel.fuel_map_io import read_fuel_map
from ltm_core.fuel.prior_config import PriorConfig
from ltm_core.fuel.prior_io import load_prior
from ltm_core.fuel.site_map import site_evidence_map
from ltm_core.fuel.stored_map import STORE_KIND, fuel_schema, open_stored_map, votes_to_bytes
from ltm_core.fuel.votes import CellVotes
from ltm_core.grid import GridGeometry
from ltm_core.numpy_io import load_arrays
from ltm_core.raster.dem_io import read_around
from ltm_core.raster.tile_store import CellChanges, FrameRecord, TileStore
from ltm_core.tracing import trace_io
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.importer.photo import read_photo

GRID = GridGeometry(480_000.0, 4_150_600.0, 30.0, 27, 20, "EPSG:26911")


# Photos


def _exif() -> Image.Exif:
    exif = Image.Exif()
    exif[0x0112], exif[0x0132] = 6, "2024:05:06 07:08:09"
    exif.get_ifd(0x8769).update(
        {0x9003: "2024:05:06 07:08:09", 0x9011: "+02:00", 0x920A: 6.86, 0xA405: 26, 0x9291: "123"}
    )
    gps = {1: "N", 2: (34.0, 12.0, 30.5), 3: "W", 4: (117.0, 5.0, 1.25), 5: b"\0", 6: 912.5, 7: (7.0, 8.0, 9.0)}
    exif.get_ifd(0x8825).update(gps | {16: "M", 17: 123.5, 29: "2024:05:06"})
    return exif


def _photos(kind: str, **options: object) -> Callable[[Path], list[bytes]]:
    def made(folder: Path) -> list[bytes]:
        from pillow_heif import register_heif_opener

        register_heif_opener()
        pixels = np.random.default_rng(3).integers(0, 255, (6, 9, 3), np.uint8).repeat(8, 0).repeat(8, 1)
        files = []
        for exif in (Image.Exif(), _exif()):
            file = io.BytesIO()
            Image.fromarray(pixels).save(file, kind, exif=exif.tobytes(), **options)
            files.append(file.getvalue())
        return files

    return made


def _read_photo(folder: Path, name: str) -> None:
    photo = read_photo(folder / name)
    photo.exif.focal_px(photo.width, photo.height)
    trace_io.read_photo(folder / name, Camera.from_fov(photo.width, photo.height, 60.0))


def _photo(suffix: str, seeds: Callable[[Path], list[bytes]]) -> Target:
    return Target(
        f"photo_{suffix}", f"a.{suffix}", seeds, lambda folder: _read_photo(folder, f"a.{suffix}"), weight=2.0
    )


# Rasters


def _dems(*drivers: str) -> Callable[[Path], list[bytes]]:
    def made(folder: Path) -> list[bytes]:
        heights, files = rough_terrain(7, (60, 81)).elevation, []
        Dem(heights, GridGeometry(480_000.0, 4_150_600.0, 10.0, 81, 60, "EPSG:26911")).save(folder / "made.tif")
        files.append((folder / "made.tif").read_bytes())
        with rasterio.open(folder / "made.tif") as source:
            profile = source.profile
        for options in (
            {"compress": "lzw", "tiled": False, "dtype": "int16", "nodata": -32768},
            {"compress": "none", "tiled": False, "predictor": 1, "dtype": "float64"},
        ):
            with rasterio.open(folder / "made.tif", "w", **(profile | options)) as sink:
                sink.write(heights.astype(options["dtype"]), 1)
                sink.scales, sink.offsets = (0.5,), (3.0,)
            files.append((folder / "made.tif").read_bytes())
        return files

    return made


def _ascii(folder: Path) -> list[bytes]:
    (folder / "dem.prj").write_text(str(rasterio.crs.CRS.from_epsg(26911).to_wkt()))
    rows = "\n".join(" ".join(f"{v:.1f}" for v in row) for row in rough_terrain(7, (12, 9)).elevation)
    head = "ncols 9\nnrows 12\nxllcorner 480000\nyllcorner 4150000\ncellsize 10\nNODATA_value -9999\n"
    return [(head + rows + "\n").encode()]


def _read_dem(name: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        try:
            Dem.open(folder / name)
        finally:
            bounds = (480_100.0, 4_150_100.0, 480_500.0, 4_150_400.0)
            read_around(folder / name, None, "EPSG:26911", bounds)
            read_around(folder / name, None, "EPSG:32612", (480_100.0 - 525_000.0, 4_150_100.0, 0.0, 4_150_400.0))

    return read


def _codes(bands: int) -> bytes:
    codes = np.random.default_rng(4).choice([101, 122, 145, 165, 91, -9999], GRID.shape).astype(np.int16)
    with rasterio.io.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", count=bands, dtype="int16", crs=GRID.crs, transform=GRID.transform(), nodata=-9999,
            width=GRID.width, height=GRID.height, compress="deflate",
        ) as sink:  # fmt: skip
            for band in range(1, bands + 1):
                sink.write(codes if band in (1, 4) else np.full_like(codes, 20 * band), band)
        return bytes(memory.read())


def _lcp(folder: Path) -> list[bytes]:
    with rasterio.io.MemoryFile(_codes(8)) as memory, memory.open() as source:
        rasterio.shutil.copy(source, folder / "made.lcp", driver="LCP", LATITUDE=34, LINEAR_UNIT="METER")
    return [(folder / "made.lcp").read_bytes()]


def _read_prior(path: Path) -> None:
    load_prior(PriorConfig(path=path, crs="EPSG:26911"), GRID)


def _fuel_map(folder: Path) -> list[bytes]:
    from ltm_core.fuel.fuel_map_io import write_fuel_map
    from ltm_core.fuel.life_form import life_form_labels

    classes = np.random.default_rng(5).integers(0, 5, GRID.shape, np.uint8)
    return [write_fuel_map(folder / "made.tif", classes, GRID, life_form_labels(LabelSet.load())).read_bytes()]


# Stores


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
    from ltm_core.site_io import load_site

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


_VALUES: tuple[object, ...] = (
    *(None, "", "x", "\udc80", b"", b"\xff\xfe", -1, 0, 2**62, -(2**63), 1.5, float("inf"), "9" * 400, "{}", "[" * 5000),
    *(zstandard.compress(bytes(64 << 20)), zstandard.compress(b"x")[:6], struct.pack("<IBBQ", 0xFD2FB528, 0xE0, 0, 1 << 45)),
    *(struct.pack("<IBQ", 0xFD2FB528, 0xE0, 1 << 45), zstandard.compress(b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'shape': (1 << 40,)}")),
    zstandard.compress(bytes(160)), zstandard.compress(b"\xff" * 160), zstandard.ZstdCompressor(write_content_size=False).compress(bytes(160)),
)  # fmt: skip
_ORDERS = (
    "DROP TABLE frames", "DELETE FROM description", "CREATE TRIGGER t AFTER INSERT ON frames BEGIN DELETE FROM tiles; END",
    "DROP TABLE tiles; CREATE VIEW tiles AS WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n+1 FROM r) SELECT n AS row, n AS col, x'' AS content FROM r",
    "DROP TABLE waiting; CREATE TABLE waiting (number, source, stamp_ns, model, payload AS (zeroblob(900000000)))",
    "PRAGMA user_version = 99", "PRAGMA application_id = 5", "INSERT INTO tiles VALUES (-1, 4000000000, x'00')",
    "INSERT INTO tiles SELECT row + 900, col + 900, content FROM tiles", "UPDATE sources SET id = NULL", "PRAGMA encoding = 'UTF-16'",
)  # fmt: skip


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
        "sources": ("id", "name", "counted", "kept", "horizon_ns"), "changes": ("number", "layer", "stamp_ns", "content"),
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
        except zstandard.ZstdError:
            value = spoil_bytes(rng, found, [found])
    elif isinstance(found, str) and rng.random() < 0.6:
        value = spoil_bytes(rng, found.encode(), [found.encode()]).decode("utf-8", "replace")
    if isinstance(value, str) and "\udc80" in value:
        database.execute(f"UPDATE {table} SET {column} = CAST(x'ff80fe' AS TEXT)")
    else:
        database.execute(f"UPDATE {table} SET {column} = ?", (value,))


# Bags


def _bags(folder: Path) -> list[bytes]:
    from ltm_core.pose import Pose
    from ltm_msgs_py.bag.writer import BagWriter
    from ltm_msgs_py.camera_info import camera_to_msg
    from ltm_msgs_py.pose import pose_to_msg

    files = []
    for number, compression in enumerate(("zstd", None)):
        with BagWriter(folder / f"made{number}", compression=compression) as bag:
            for stamp in (10**18, 10**18 + 5, 10**18 + 9):
                bag.write("/a/camera_info", camera_to_msg(Camera.from_fov(12, 7, 60.0), stamp, "a"), stamp)
                bag.write("/a/pose", pose_to_msg(Pose.from_angles((1.0, 2.0, 3.0), 4.0), stamp), stamp)
        files += [file.read_bytes() for file in (folder / f"made{number}").glob("*.mcap")]
    return files


def _read_bag(folder: Path) -> None:
    from ltm_core.errors import RecordingError

    reader = BagReader(folder / "a.mcap")
    for message in reader.messages():
        try:
            reader.decode(message)
        except RecordingError:
            continue
    for _ in reader.messages(["/a/pose"], 10**18, 10**18 + 6):
        pass


_RECORD = struct.Struct("<BQ")


def _records(data: bytes) -> list[tuple[int, bytes]]:
    at, found = 8, []
    while at + _RECORD.size <= len(data) - 8:
        opcode, length = _RECORD.unpack_from(data, at)
        found.append((opcode, data[at + _RECORD.size : at + _RECORD.size + length]))
        at += _RECORD.size + length
    return found


def _spoil_bag(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    """Two thirds are spoiled record by record, lengths kept right; half of those within a chunk, which is packed anew."""
    if rng.random() < 0.34:
        return spoil_bytes(rng, data, seeds)
    records = _records(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(records))
        opcode, body = records[at]
        if opcode == 6 and rng.random() < 0.8:
            records[at] = opcode, _chunk(rng, body)
        else:
            way = rng.random()
            if way < 0.7:
                records[at] = opcode, spoil_bytes(rng, body, [body])
            elif way < 0.85:
                records.insert(rng.randrange(len(records)), records[at])
            else:
                records[at] = rng.randrange(256), body
    whole = b"".join(_RECORD.pack(opcode, len(body)) + body for opcode, body in records)
    if rng.random() < 0.5:  # without a summary: the records before are walked over
        whole = whole[: rng.randrange(len(whole) + 1)]
        return data[:8] + whole
    return data[:8] + whole + data[-8:]


def _chunk(rng: random.Random, body: bytes) -> bytes:
    start, end, size, _crc, name_length = struct.unpack_from("<QQQII", body)
    compression = body[32 : 32 + name_length]
    packed = body[32 + name_length + 8 :]
    try:
        inner = zstandard.decompress(packed, max_output_size=size) if compression == b"zstd" else packed
    except zstandard.ZstdError:
        inner = packed
    way = rng.random()
    if way < 0.6:
        inner = spoil_bytes(rng, inner, [inner])
    elif way < 0.75:
        inner = bytes([rng.choice((0, 5))]) * rng.choice(
            (1000, 60 << 20, 130 << 20)
        )  # empty records, or one without end
    elif way < 0.9:
        inner = (_RECORD.pack(5, 22) + bytes(22)) * rng.choice((10, 2_000_000))
    compression = rng.choice((compression, compression, b"", b"zstd", b"lz4", b"zstd\xff"))
    stated = rng.choice((len(inner), len(inner), 0, 1 << 20, 1 << 45))
    if compression == b"zstd":
        packed = zstandard.compress(inner)
        if rng.random() < 0.15:
            packed = struct.pack("<IBQ", 0xFD2FB528, 0xE0, 1 << 45) + packed[8:]
    elif compression == b"lz4":
        import lz4.frame

        packed = lz4.frame.compress(inner)
    else:
        packed = inner[: 1 << 20]
    head = struct.pack("<QQQII", start, end, stated, 0, len(compression)) + compression
    return head + struct.pack("<Q", len(packed)) + packed


# Networks and arrays


def _network(folder: Path) -> list[bytes]:
    write_classifier(folder)
    return [(folder / "colors.onnx").read_bytes()]


def _read_network(folder: Path) -> None:
    """The manifest states the spoiled file's checksum, as one that was made to harm would."""
    manifest = yaml.safe_load((folder / "colors.yaml").read_text())
    manifest["sha256"] = hashlib.sha256((folder / "colors.onnx").read_bytes()).hexdigest()
    (folder / "colors.yaml").write_text(yaml.safe_dump(manifest))
    Segmenter.open(folder / "colors.yaml").segment(np.zeros((HEIGHT, WIDTH, 3), np.uint8))


def _npz(folder: Path) -> list[bytes]:
    files = []
    for save in (np.savez, np.savez_compressed):
        file = io.BytesIO()
        save(file, names=np.array(["a", "bc"]), embeddings=np.asfortranarray(np.ones((2, 3), np.float32)))
        files.append(file.getvalue())
    return files


def _depth_maps(suffix: str) -> Callable[[Path], list[bytes]]:
    def made(folder: Path) -> list[bytes]:
        import cv2

        (folder / "maps").mkdir()
        (folder / "maps/depth_maps.yaml").write_text("metres_per_unit: 0.001\n")
        depth = np.random.default_rng(6).integers(1, 60_000, (9, 14)).astype(np.uint16)
        file = io.BytesIO()
        np.save(file, depth.astype(np.float32))
        return [file.getvalue()] if suffix == "npy" else [cv2.imencode(f".{suffix}", depth)[1].tobytes()]

    return made


def _read_depth_map(folder: Path) -> None:
    DepthMapFolder.open("maps", folder / "maps").of_frame("a", 5, (90, 140), Camera.from_fov(14, 9, 50.0))


def _file(name: str, file: str, seeds: Callable[[Path], list[bytes]], read: Callable[[Path], object]) -> Target:
    return Target(name, file, seeds, lambda folder: read(folder / file))


BINARY_FILES: Sequence[Target] = (
    _photo("jpg", _photos("JPEG", quality=90)),
    _photo("png", _photos("PNG")),
    _photo("heic", _photos("HEIF")),
    Target(
        "photo_progressive", "a.jpg", _photos("JPEG", progressive=True), lambda folder: _read_photo(folder, "a.jpg")
    ),
    Target("dem_tif", "dem.tif", _dems(), _read_dem("dem.tif"), weight=2.0),
    Target("dem_asc", "dem.asc", _ascii, _read_dem("dem.asc")),
    _file("prior_tif", "prior.tif", lambda folder: [_codes(1), _codes(8)], _read_prior),
    _file("prior_lcp", "prior.lcp", _lcp, _read_prior),
    Target("prior_folder", "fbfm40.tif", lambda folder: [_codes(1)], _read_prior),
    _file("fuel_map", "map.tif", _fuel_map, read_fuel_map),
    Target("store", "fuel_map.ltm", _stores, _read_store, _spoil_store, weight=3.0),
    Target("bag", "a.mcap", _bags, _read_bag, _spoil_bag, weight=3.0),
    Target("network", "colors.onnx", _network, _read_network),
    _file("npz", "a.npz", _npz, lambda path: load_arrays(path, ("names", "embeddings"), 1 << 20, ConfigError)),
    *(
        Target(f"depth_map_{suffix}", f"maps/a_5.{suffix}", _depth_maps(suffix), _read_depth_map)
        for suffix in ("npy", "png", "tif")
    ),
)
