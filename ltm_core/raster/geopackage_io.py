"""Read the lines and areas, or the points, of a GeoPackage layer.

A GeoPackage is an SQLite file whose geometries are blobs: a header, then well-known binary (OGC 12-128r19, clause
2.1.3; OGC 06-103r4, clause 8). GDAL is not used for it: rasterio offers rasters only, and another GDAL beside it ends
the process on damaged files.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar
from urllib.parse import quote

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float64Array

T = TypeVar("T")
MOST_FEATURES: Final = 1_000_000
_ENVELOPE: Final = {0: 0, 1: 32, 2: 48, 3: 48, 4: 64}
"""Size in bytes of the header's envelope by its kind."""
_LINE, _POLYGON, _MULTILINE, _MULTIPOLYGON, _COLLECTION = 2, 3, 5, 6, 7


@dataclass(frozen=True, eq=False)
class VectorLayer:
    """`lines`: (N, 2) float64 of x and y each. `areas`: their rings, the first outside, each (N, 2). `crs`: WKT."""

    lines: list[Float64Array]
    areas: list[list[Float64Array]]
    crs: str


def read_geopackage(path: Path, layer: str | None = None) -> VectorLayer:
    """Read the lines and areas of a layer, without points; `layer` is optional if the file has only one.

    Raises RasterError for a file that is no GeoPackage or damaged, a layer that it lacks, or one without CRS.
    """
    return _read(path, lambda database: _layer(database, path, layer))


def read_points(path: Path) -> tuple[list[dict[str, Any]], str]:
    """Read the columns of a file's only layer of points, by name in lower case with `_` for spaces, with `x` and `y`;
    and its CRS as WKT. Raises RasterError as `read_geopackage`."""
    return _read(path, lambda database: _points(database, path))


def _read(path: Path, read: Callable[[sqlite3.Connection], T]) -> T:
    if not path.is_file():
        raise RasterError(f"{path}: no such file; a vector layer is a GeoPackage (.gpkg)")
    try:
        with closing(sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1", uri=True)) as database:
            return read(database)
    except (sqlite3.Error, struct.error, ValueError, OverflowError) as error:
        raise RasterError(f"{path}: cannot be read as a GeoPackage, or is damaged ({error})") from error


def _table(database: sqlite3.Connection, path: Path, layer: str | None) -> tuple[str, str, sqlite3.Cursor]:
    """Return the name and CRS of a layer, and a cursor over its geometries, each followed by all columns."""
    tables = {str(row[0]): row[1:] for row in database.execute(
        "SELECT table_name, column_name, srs_id FROM gpkg_geometry_columns"
    )}  # fmt: skip
    there = ", ".join(tables) or "none"
    if layer is None and len(tables) != 1:
        raise RasterError(f"{path}: name the layer; it has the layers {there}")
    name = next(iter(tables)) if layer is None else layer
    if name not in tables:
        raise RasterError(f"{path}: no layer {name!r}; it has the layers {there}")
    column, number = tables[name]
    quoted = (f'"{str(word).replace(chr(34), 2 * chr(34))}"' for word in (column, name))
    return name, _crs(database, path, number), database.execute("SELECT {}, * FROM {}".format(*quoted))


def _layer(database: sqlite3.Connection, path: Path, layer: str | None) -> VectorLayer:
    name, crs, rows = _table(database, path, layer)
    lines: list[Float64Array] = []
    areas: list[list[Float64Array]] = []
    for count, (blob, *_) in enumerate(rows):
        if count >= MOST_FEATURES:
            raise RasterError(f"{path}: more than {MOST_FEATURES} features in {name}: clip it to the site")
        for line, rings in _shapes(blob):
            if line is not None:
                lines += [line] if len(line) > 1 else []
            elif rings:
                areas.append(rings)
    return VectorLayer(lines, areas, crs)


def _points(database: sqlite3.Connection, path: Path) -> tuple[list[dict[str, Any]], str]:
    _, crs, rows = _table(database, path, None)
    names, found = [str(column[0]).lower().replace(" ", "_") for column in rows.description[1:]], []
    for blob, *values in rows.fetchmany(MOST_FEATURES):
        point, _ = next(_shapes(blob), (None, []))
        if point is None or len(point) != 1:
            raise ValueError("a geometry is not a point")
        found.append(dict(zip(names, values, strict=True)) | {"x": float(point[0, 0]), "y": float(point[0, 1])})
    return found, crs


def _crs(database: sqlite3.Connection, path: Path, number: Any) -> str:
    row = database.execute(
        "SELECT organization, organization_coordsys_id, definition FROM gpkg_spatial_ref_sys WHERE srs_id = ?",
        (number,),
    ).fetchone()
    for text in () if row is None or number in (-1, 0) else (f"{row[0]}:{row[1]}", row[2]):
        try:
            return str(CRS.from_user_input(text).to_wkt())
        except CRSError:
            continue
    raise RasterError(f"{path}: the layer has no known CRS; write it again with one")


def _shapes(blob: Any) -> Iterator[tuple[Float64Array | None, list[Float64Array]]]:
    """Return a line, a point as a line of one, or the rings of an area, for each part of a geometry."""
    if not isinstance(blob, bytes) or len(blob) < 8 or blob[:2] != b"GP":
        if blob is None:
            return
        raise ValueError("a geometry has no valid header")
    flags = blob[3]
    envelope = _ENVELOPE.get(flags >> 1 & 7)
    if envelope is None:
        raise ValueError("a geometry has an unknown type of envelope")
    if not flags & 16:  # empty
        yield from _Wkb(blob, 8 + envelope).shapes()


class _Wkb:
    """Reads well-known binary from a place on."""

    def __init__(self, blob: bytes, at: int) -> None:
        self._blob, self._at = blob, at

    def shapes(self, depth: int = 0) -> Iterator[tuple[Float64Array | None, list[Float64Array]]]:
        order = "<" if self._take("B")[0] == 1 else ">"
        (kind,) = self._take(f"{order}I")
        # ISO counts dimensions in thousands, EWKB in high bits.
        iso = kind & 0x0FFFFFFF
        width = 2 + (iso // 1000 in (1, 3)) + (iso // 1000 in (2, 3)) + bool(kind >> 31) + bool(kind >> 30 & 1)
        kind = iso % 1000
        if kind == 1:
            yield np.array([self._take(f"{order}{width}d")[:2]]), []
        elif kind == _LINE:
            yield self._points(order, width), []
        elif kind == _POLYGON:
            yield None, [self._points(order, width) for _ in range(self._count(order, 4))]
        elif kind in (4, _MULTILINE, _MULTIPOLYGON, _COLLECTION) and depth < 8:
            for _ in range(self._count(order, 5)):
                yield from self.shapes(depth + 1)
        else:
            raise ValueError(f"unsupported geometry type {kind}: write lines and areas without arcs")

    def _take(self, form: str) -> tuple[Any, ...]:
        found = struct.unpack_from(form, self._blob, self._at)
        self._at += struct.calcsize(form)
        return found

    def _count(self, order: str, least: int) -> int:
        """Read the count of items of at least `least` bytes each; a damaged count must not allocate memory."""
        (count,) = self._take(f"{order}I")
        if count * least > len(self._blob) - self._at:
            raise ValueError("a geometry is shorter than it states")
        return int(count)

    def _points(self, order: str, width: int) -> Float64Array:
        count = self._count(order, 8 * width)
        points = np.frombuffer(self._blob, f"{order}f8", count * width, self._at).reshape(count, width)
        self._at += 8 * count * width
        if not np.isfinite(points[:, :2]).all():
            raise ValueError("a geometry has non-finite coordinates")
        return points[:, :2].astype(np.float64)
