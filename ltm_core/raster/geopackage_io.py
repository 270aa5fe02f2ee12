"""Read the points of a GeoPackage.

A GeoPackage is an SQLite file whose geometries are blobs: a header, then well-known binary (OGC 12-128r19, clause
2.1.3; OGC 06-103r4, clause 8). GDAL is not used for it: rasterio offers rasters only, and another GDAL beside it ends
the process on damaged files."""

import math
import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from pyproj import CRS
from pyproj.exceptions import CRSError

from ltm_core.base.errors import RasterError

MOST_POINTS: Final = 100_000
_ENVELOPE: Final = {0: 0, 1: 32, 2: 48, 3: 48, 4: 64}
"""Size in bytes of the header's envelope by its kind."""


def read_points(path: Path) -> tuple[list[dict[str, Any]], str]:
    """Read the columns of a file's only layer of points, by name in lower case with `_` for spaces, with `x` and `y`;
    and its CRS as WKT.

    Raises RasterError for a file that is no GeoPackage or damaged, or whose layer is not one of points with a CRS."""
    if not path.is_file():
        raise RasterError(f"{path}: no such file; give a GeoPackage (.gpkg) of points")
    try:
        with closing(sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1", uri=True)) as database:
            return _points(database, path)
    except (sqlite3.Error, struct.error, ValueError, IndexError, OverflowError) as error:
        raise RasterError(f"{path}: cannot be read as a GeoPackage of points, or is damaged ({error})") from error


def _points(database: sqlite3.Connection, path: Path) -> tuple[list[dict[str, Any]], str]:
    tables = database.execute("SELECT table_name, column_name, srs_id FROM gpkg_geometry_columns").fetchall()
    if len(tables) != 1:
        there = ", ".join(str(table[0]) for table in tables) or "none"
        raise RasterError(f"{path}: expected one layer, found {there}; write the points into a separate file")
    table, column, number = tables[0]
    found: list[dict[str, Any]] = []
    quoted = (f'"{str(word).replace(chr(34), 2 * chr(34))}"' for word in (column, table))
    rows = database.execute("SELECT {}, * FROM {}".format(*quoted))
    names = [str(entry[0]).lower().replace(" ", "_") for entry in rows.description[1:]]
    for blob, *values in rows:
        if len(found) == MOST_POINTS:
            raise RasterError(f"{path}: more than {MOST_POINTS:,} points; write fewer")
        x, y = _point(blob)
        found.append(dict(zip(names, values, strict=True)) | {"x": x, "y": y})
    return found, _crs(database, path, number)


def _point(blob: Any) -> tuple[float, float]:
    """Return a point, or the first one of a multipoint. Raises ValueError for another geometry."""
    if not isinstance(blob, bytes) or blob[:2] != b"GP" or (envelope := _ENVELOPE.get(blob[3] >> 1 & 7)) is None:
        raise ValueError("a geometry has no valid header")
    at = 8 + envelope
    kind = 0
    for _ in range(2):
        order = "<" if blob[at] == 1 else ">"
        kind = struct.unpack_from(f"{order}I", blob, at + 1)[0] & 0x0FFFFFFF  # EWKB counts dimensions in high bits
        if kind % 1000 != 4:  # ISO counts them in thousands
            break
        at += 9
    x, y = struct.unpack_from(f"{order}2d", blob, at + 5)
    if kind % 1000 != 1 or not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError("a geometry is not a point")
    return x, y


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
