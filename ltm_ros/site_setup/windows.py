"""Read windows of remote GeoTIFF files by range requests, and write them as whole files on their own grid.

Only the directory of a file and the blocks of the window are fetched, into a sparse copy that GDAL then reads. Thus
sizes are known before and exact afterwards, each request is repeated on its own, and an interrupted window continues.
GDAL's `/vsicurl/` states no sizes before it reads; here a stalled server once held Python's lock in it. An `opener` of
rasterio would replace the reading of directories and ranges, but an interrupted window would begin again."""

import math
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.redaction import redacted
from ltm_core.raster.raster_io import open_raster
from ltm_core.storage.disk_io import written_whole
from ltm_ros.site_setup.request import Area, FetchError, Part, Progress, Remote
from ltm_ros.site_setup.web import Web, check_room, digest, only_writer

MARGIN_CELLS = 3
"""Cells beyond the area on each side, so that an interpolation at its edge has its neighbours."""
_HEADER_BYTES = 64 << 10
"""Cloud Optimized GeoTIFFs have their directories here."""
_VALUE_BYTES = {3: 2, 4: 4, 5: 8, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
"""Sizes of the values in a directory by type; others have one byte."""
_MOST_VALUES_BYTES = 64 << 20
_MOST_DIRECTORIES = 40
_LEADER_BYTES = 4
"""Cloud Optimized GeoTIFFs repeat the size of a block before it, and its end after it."""
_GAP_BYTES = 4 << 10
_RANGE_BYTES = 4 << 20
"""Blocks with gaps up to the one are fetched together, up to the other."""
_CONNECTIONS = 4
_JOURNAL = ".ranges"

Window = tuple[int, int, int, int]
"""First column, first row, columns and rows."""


def plan_window(remote: Remote, area: Area, name: str, tile: str, web: Web) -> Part | None:
    """Return the window of a file that covers an area, with the bytes of its blocks; None if they do not meet.

    Raises FetchError if the server delivers only whole files, or no GeoTIFF."""
    if not remote.ranges:
        raise FetchError(
            f"{redacted(remote.url)}: the server does not deliver parts of files (HTTP ranges); download the file, and "
            "give it to ltm init"
        )
    web.make_cache()
    path = web.cache / f"{digest(remote.url, remote.version, 'header')}.part"
    with only_writer(path):
        _write_header(path, remote, web)
        with _opened(path, remote.url) as source:
            window = window_of(source, area)
            size = 0 if window is None else sum(last - first for first, last in _block_ranges(source, window))
        path.unlink()
    size += min(_HEADER_BYTES, remote.size)
    return None if window is None else Part(remote.url, name, size, remote, window, tile)


def window_of(source: Any, area: Area) -> Window | None:
    """Return the whole cells of a raster that cover an area, with a margin; None if there is none."""
    from rasterio.warp import transform_bounds

    if source.crs is None:
        raise FetchError(f"{redacted(source.name)}: has no CRS; choose another source")
    west, south, east, north = transform_bounds("EPSG:4326", source.crs, *area.bounds_lonlat, densify_pts=21)
    corners = np.array([[west, west, east, east], [south, north, south, north], np.ones(4)])
    first, *_, last = np.sort(np.reshape(~source.transform, (3, 3))[:2] @ corners).T
    if (first >= (source.width, source.height)).any() or (last <= 0).any():
        return None
    column, row = (max(math.floor(v) - MARGIN_CELLS, 0) for v in first)
    right = min(math.ceil(last[0]) + MARGIN_CELLS, source.width)
    bottom = min(math.ceil(last[1]) + MARGIN_CELLS, source.height)
    return column, row, right - column, bottom - row


def fetch_window(
    remote: Remote, window: Window, web: Web, progress: Progress, nodata: float | None, tags: dict[str, str]
) -> Path:
    """Return the file of a window in the cache. Raises FetchError."""
    path = web.cache / f"{digest(remote.url, remote.version, window, nodata)}.tif"
    if path.exists():
        return path
    web.make_cache()
    sparse = path.with_suffix(".part")
    with only_writer(sparse):
        _write_header(sparse, remote, web)
        with _opened(sparse, remote.url) as source:
            ranges = _block_ranges(source, window)
        _write_ranges(sparse, ranges, remote, web, progress)
        try:
            with _opened(sparse, remote.url) as source:
                _write(path, source, window, nodata, tags)
        finally:  # what cannot be read now is not kept for the next run
            sparse.unlink()
            sparse.with_suffix(_JOURNAL).unlink(missing_ok=True)
    return path


def _write_header(path: Path, remote: Remote, web: Web) -> None:
    """Write to a sparse file what GDAL needs to open a remote GeoTIFF: its beginning, and its directories with all
    values, wherever they are. Blocks whose sizes were missing would be read as unknown cells."""
    head = web.piece(remote, 0, _HEADER_BYTES)
    big = head[2:4] in (b"+\0", b"\0+")
    if head[:4] not in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+") or len(head) < 16:
        raise FetchError(f"{redacted(remote.url)}: not a GeoTIFF; check the address of the source")
    pieces = {0: head}

    def read(first: int, length: int) -> bytes:
        for at, piece in pieces.items():
            if at <= first and first + length <= at + len(piece):
                return piece[first - at : first - at + length]
        if first + length > remote.size or length > _MOST_VALUES_BYTES:
            raise FetchError(f"{redacted(remote.url)}: not a valid GeoTIFF; choose another source")
        pieces[first] = web.piece(remote, first, length)
        return pieces[first]

    def unpacked(layout: str, first: int, count: int = 1) -> Iterator[tuple[Any, ...]]:
        whole = ("<" if head[:1] == b"I" else ">") + layout
        return struct.iter_unpack(whole, read(first, count * struct.calcsize(whole)))

    pointer, number, entry = ("Q", "Q", "HHQQ") if big else ("I", "H", "HHII")
    ((directory,),) = unpacked(pointer, 8 if big else 4)
    for _ in range(_MOST_DIRECTORIES):  # of the raster, its overviews and its mask
        if not directory:
            break
        ((entries,),) = unpacked(number, directory)
        table = directory + struct.calcsize(number)
        for _, kind, count, at in unpacked(entry, table, entries):
            length = count * _VALUE_BYTES.get(kind, 1)
            if length > struct.calcsize(pointer):
                read(at, length)
        ((directory,),) = unpacked(pointer, table + entries * struct.calcsize(f"<{entry}"))
    with path.open("r+b") as file:
        for first, piece in pieces.items():
            file.seek(first)
            file.write(piece)
        file.truncate(remote.size)


@contextmanager
def _opened(path: Path, url: str) -> Iterator[Any]:
    """Open a sparse copy; other formats than GeoTIFF could name files and hosts. Raises FetchError."""
    from rasterio.enums import MaskFlags

    try:
        with open_raster(path, driver="GTiff") as source:
            if MaskFlags.per_dataset in source.mask_flag_enums[0]:
                raise FetchError(f"{redacted(url)}: has a mask, not nodata; download it, and give it to ltm init")
            yield source
    except RasterError as error:
        raise FetchError(f"{redacted(url)}: not a GeoTIFF that can be read ({error}); choose another source") from error


def _block_ranges(source: Any, window: Window) -> list[tuple[int, int]]:
    """Return where in the file the blocks of a window are, as few ranges. Raises FetchError if it is not stated."""
    column, row, columns, rows = window
    height, width = source.block_shapes[0]
    ys = range(row // height, (row + rows - 1) // height + 1)
    xs = range(column // width, (column + columns - 1) // width + 1)
    blocks = []
    for place in (f"{x}_{y}" for y in ys for x in xs):
        first, size = (
            int(source.get_tag_item(f"BLOCK_{what}_{place}", "TIFF", bidx=1) or 0) for what in ("OFFSET", "SIZE")
        )
        if size:
            blocks.append((max(first - _LEADER_BYTES, 0), first + size + _LEADER_BYTES))
    if not blocks:
        raise FetchError(f"{redacted(source.name)}: no data in the window, or not a Cloud Optimized GeoTIFF")
    ranges: list[tuple[int, int]] = []
    for first, last in sorted(blocks):
        if ranges and first <= ranges[-1][1] + _GAP_BYTES and last - ranges[-1][0] <= _RANGE_BYTES:
            ranges[-1] = ranges[-1][0], max(last, ranges[-1][1])
        else:
            ranges.append((first, last))
    return ranges


def _write_ranges(sparse: Path, ranges: list[tuple[int, int]], remote: Remote, web: Web, progress: Progress) -> None:
    """Fetch ranges of a file into its sparse copy, but not those that an interrupted run has already."""
    journal = sparse.with_suffix(_JOURNAL)
    have = set(journal.read_text().split()) if journal.exists() else set()
    missing = [(first, last) for first, last in ranges if f"{first}-{last}" not in have]
    done = sum(last - first for first, last in set(ranges) - set(missing))
    pool = ThreadPoolExecutor(_CONNECTIONS)
    try:
        with sparse.open("r+b") as file, journal.open("a") as noted:
            for at in range(0, len(missing), _CONNECTIONS):
                few = missing[at : at + _CONNECTIONS]
                pieces = pool.map(lambda span: web.piece(remote, span[0], span[1] - span[0]), few)
                for (first, last), piece in zip(few, pieces, strict=True):
                    file.seek(first)
                    file.write(piece)
                    file.flush()
                    noted.write(f"{first}-{last}\n")
                    done += len(piece)
                    progress(done, done)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # requests in flight may take minutes


def _write(path: Path, source: Any, window: Window, nodata: float | None, tags: dict[str, str]) -> None:
    """Write a window of a raster's first band as a GeoTIFF that appears whole or not at all. `nodata`: of a raster that
    declares none.

    Raises FetchError or ConfigError if the disk does not take it."""
    from rasterio.io import MemoryFile
    from rasterio.windows import Window as Cells

    cells = Cells(*window)
    values = source.read(1, window=cells)
    nodata = nodata if source.nodatavals[0] is None else source.nodatavals[0]
    unknown = np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, bool)
    if nodata is not None and not np.isnan(nodata):
        unknown |= values == values.dtype.type(nodata)
    if nodata is None and unknown.any():
        nodata = np.nan if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)
    if nodata is not None:
        values[unknown] = nodata
    height, width = values.shape
    shape = {"width": width, "height": height, "count": 1, "dtype": values.dtype, "nodata": nodata}
    tiled = {"tiled": True, "blockxsize": 256, "blockysize": 256, "compress": "deflate", "zlevel": 1}
    place = {"crs": source.crs, "transform": source.window_transform(cells)}
    with MemoryFile() as memory:  # GDAL keeps the errors of a full disk to itself
        with memory.open(driver="GTiff", BIGTIFF="IF_SAFER", **shape, **tiled, **place) as sink:
            sink.write(values, 1)
            sink.update_tags(**tags)
            sink.scales, sink.offsets = source.scales[:1], source.offsets[:1]
            if source.units[0]:
                sink.set_band_unit(1, source.units[0])
            if source.descriptions[0]:
                sink.set_band_description(1, source.descriptions[0])
        check_room(path.parent, len(memory.getbuffer()))
        with written_whole(path) as partial:
            partial.write_bytes(memory.getbuffer())
