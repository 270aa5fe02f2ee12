"""Read windows of remote GeoTIFF files (/vsicurl/), and write them as whole files on their own grid."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import RasterError
from ltm_core.base.redaction import redacted
from ltm_core.raster.raster_io import open_raster, read_band
from ltm_core.storage.disk_io import written_whole
from ltm_ros.site_setup.request import Area, FetchError, NoCoverageError, Part, Progress
from ltm_ros.site_setup.web import AgainError, Remote, Web, check_room, digest, put_into

MARGIN_CELLS = 3
"""Cells beyond the area on each side, so that an interpolation at its edge has its neighbours."""
MOST_CELLS = 1 << 28
"""Maximum number of cells of an area: 16 km per side at 1 m."""
_HEADER_BYTES = 32 << 10
"""GDAL reads this much when it opens a file."""


@contextmanager
def open_window_source(url: str, web: Web) -> Iterator[Any]:
    """Open a remote GeoTIFF; other formats could name files and hosts. Raises RasterError."""
    import rasterio

    seconds = math.ceil(web.timeout_s)
    settings = {
        "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
        "GDAL_INGESTED_BYTES_AT_OPEN": _HEADER_BYTES,
        "GDAL_HTTP_MERGE_CONSECUTIVE_RANGES": "YES",
        "GDAL_HTTP_CONNECTTIMEOUT": min(20, seconds),
        "GDAL_HTTP_TIMEOUT": seconds,
        "CPL_VSIL_CURL_USE_HEAD": "NO",
        "CPL_VSIL_CURL_NON_CACHED": "/vsicurl/",  # a failed read would be remembered
    }
    with rasterio.Env(**settings), open_raster(f"/vsicurl/{url}", driver="GTiff") as source:
        yield source


def plan_window(remote: Remote, area: Area, name: str, tile: str, web: Web) -> Part | None:
    """Return the window of a file that covers an area, with the bytes of its blocks; None if they do not meet.

    Raises FetchError if the server delivers only whole files, or no GeoTIFF.
    """
    if not remote.ranges:
        raise FetchError(
            f"{redacted(remote.url)}: the server does not deliver parts of files (HTTP ranges); download the file, and "
            "give it to ltm init"
        )

    def attempt() -> Part | None:
        try:
            with open_window_source(remote.url, web) as source:
                window = window_of(source, area)
                if window is None:
                    return None
                size = _block_bytes(source, window)
        except RasterError as error:
            raise AgainError(redacted(str(error))) from error
        return Part(remote.url, name, size, remote.version, window, tile)

    web.bytes_read += min(_HEADER_BYTES, remote.size)
    return web.tried(redacted(remote.url), attempt)


def window_of(source: Any, area: Area) -> tuple[int, int, int, int] | None:
    """Return the whole cells of a raster that cover an area, with a margin: column, row, columns, rows."""
    from rasterio.warp import transform_bounds

    if source.crs is None:
        raise FetchError(f"{redacted(source.name)}: has no CRS; choose another source")
    west, south, east, north = transform_bounds("EPSG:4326", source.crs, *area.bounds_lonlat, densify_pts=21)
    inverse = ~source.transform
    corners = [inverse * (x, y) for x in (west, east) for y in (south, north)]
    first, last = np.min(corners, axis=0), np.max(corners, axis=0)
    if (first >= (source.width, source.height)).any() or (last <= 0).any():
        return None
    column, row = (max(math.floor(v) - MARGIN_CELLS, 0) for v in first)
    right = min(math.ceil(last[0]) + MARGIN_CELLS, source.width)
    bottom = min(math.ceil(last[1]) + MARGIN_CELLS, source.height)
    return column, row, right - column, bottom - row


def _block_bytes(source: Any, window: tuple[int, int, int, int]) -> int:
    """Return the compressed size of the blocks that a window touches."""
    column, row, columns, rows = window
    height, width = source.block_shapes[0]
    sizes = (
        source.get_tag_item(f"BLOCK_SIZE_{x}_{y}", "TIFF", bidx=1)
        for y in range(row // height, (row + rows - 1) // height + 1)
        for x in range(column // width, (column + columns - 1) // width + 1)
    )
    return sum(int(size or 0) for size in sizes)


def fetch_parts(
    parts: Sequence[Part], folder: Path, web: Web, progress: Progress, nodata: float | None, tags: dict[str, str]
) -> tuple[list[Path], list[Part]]:
    """Fetch windows into `folder`, and return the files, and the parts that they came from.

    Finished windows are kept in the cache. A later part of the same tile is fetched only if the former ones have
    unknown cells. Raises NoCoverageError if every cell is unknown, FetchError.
    """
    files, used, done = [], [], 0
    total = sum(part.expected_bytes for part in parts)
    check_room(web.cache, total)
    known: dict[str, NDArray[np.bool_]] = {}
    for part in parts:
        before = known.get(part.tile)
        if before is None or not before.all():
            path = fetch_window(part, web, nodata, tags)
            with open_raster(path, driver="GTiff") as source:
                here = ~read_band(source, 1)[1]
            if here.any():
                files.append(put_into(folder, path, part.name))
                used.append(part)
            if part.tile:
                known[part.tile] = here if before is None or before.shape != here.shape else before | here
        done += part.expected_bytes
        progress(done, total)
    if not files:
        raise NoCoverageError("every cell of the area is unknown (sea, or outside the survey); choose another source")
    return files, used


def fetch_window(part: Part, web: Web, nodata: float | None, tags: dict[str, str]) -> Path:
    """Return the file of a window in the cache. Raises FetchError."""
    path = web.cache / f"{digest(part.url, part.version, part.window, nodata)}.tif"
    if path.exists():
        return path

    def attempt() -> None:
        from rasterio.windows import Window

        assert part.window is not None
        try:
            with open_window_source(part.url, web) as source:
                window = Window(*part.window)
                values, unknown = read_band(source, 1, window)
                web.bytes_read += part.expected_bytes
                declared = source.nodatavals[0]
                write_band(path, values, unknown, source, window, nodata if declared is None else declared, tags)
        except RasterError as error:
            raise AgainError(redacted(str(error))) from error

    web.make_cache()
    web.tried(redacted(part.url), attempt)
    return path


def write_band(
    path: Path,
    values: NDArray[Any],
    unknown: NDArray[np.bool_],
    source: Any,
    window: Any,
    nodata: float | None,
    tags: dict[str, str],
    band: int = 1,
) -> None:
    """Write one band of a raster, or a window of it, as a GeoTIFF that appears whole or not at all.

    Raises FetchError if the disk does not take it.
    """
    from rasterio.io import MemoryFile

    if nodata is None and unknown.any():
        nodata = np.nan if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)
    if nodata is not None:
        values[unknown] = nodata
    height, width = values.shape
    shape = {"width": width, "height": height, "count": 1, "dtype": values.dtype, "nodata": nodata}
    tiled = {"tiled": True, "blockxsize": 256, "blockysize": 256, "compress": "deflate", "zlevel": 1}
    place = {"crs": source.crs, "transform": source.window_transform(window) if window else source.transform}
    with MemoryFile() as memory:  # GDAL keeps the errors of a full disk to itself
        with memory.open(driver="GTiff", BIGTIFF="IF_SAFER", **shape, **tiled, **place) as sink:
            sink.write(values, 1)
            sink.update_tags(**tags)
            sink.scales, sink.offsets = [source.scales[band - 1]], [source.offsets[band - 1]]
            if source.units[band - 1]:
                sink.set_band_unit(1, source.units[band - 1])
            if source.descriptions[band - 1]:
                sink.set_band_description(1, source.descriptions[band - 1])
        check_room(path.parent, len(memory.getbuffer()))
        with written_whole(path) as partial:
            partial.write_bytes(memory.getbuffer())
