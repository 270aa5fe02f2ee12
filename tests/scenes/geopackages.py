"""Small GeoPackages, as other programs write them: an SQLite file of layers of lines or areas."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Sequence
from pathlib import Path

from pyproj import CRS

Points = Sequence[tuple[float, float]]


def line(points: Points, order: str = "<") -> bytes:
    return _head(2, order) + _points(points, order)


def area(rings: Sequence[Points], order: str = "<") -> bytes:
    count = struct.pack(f"{order}I", len(rings))
    return _head(3, order) + count + b"".join(_points(ring, order) for ring in rings)


def several(kind: int, parts: Sequence[bytes]) -> bytes:
    """A multi-line (5), multi-polygon (6) or collection (7)."""
    return _head(kind, "<") + struct.pack("<I", len(parts)) + b"".join(parts)


def _head(kind: int, order: str) -> bytes:
    return struct.pack(f"{order}BI", order == "<", kind)


def _points(points: Points, order: str) -> bytes:
    return struct.pack(f"{order}I", len(points)) + b"".join(struct.pack(f"{order}2d", *point) for point in points)


def add_layer(path: Path, name: str, shapes: Sequence[bytes | None], epsg: int = 32611) -> Path:
    """Adds a layer of geometries (well-known binary; None: a feature without one) to a GeoPackage, made where it is
    not there.
    """
    database = sqlite3.connect(path)
    with database:
        database.execute(
            "CREATE TABLE IF NOT EXISTS gpkg_spatial_ref_sys (srs_name TEXT, srs_id INTEGER PRIMARY KEY, "
            "organization TEXT, organization_coordsys_id INTEGER, definition TEXT)"
        )
        database.execute(
            "CREATE TABLE IF NOT EXISTS gpkg_geometry_columns (table_name TEXT PRIMARY KEY, column_name TEXT, "
            "geometry_type_name TEXT, srs_id INTEGER, z TINYINT, m TINYINT)"
        )
        crs = ("of the test", epsg, "EPSG", epsg, CRS.from_epsg(epsg).to_wkt() if epsg > 0 else "undefined")
        database.execute("INSERT OR REPLACE INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?)", crs)
        database.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', 'GEOMETRY', ?, 0, 0)", (name, epsg))
        database.execute(f'CREATE TABLE "{name}" (fid INTEGER PRIMARY KEY, geom BLOB)')
        for shape in shapes:
            blob = None if shape is None else b"GP\x00\x01" + struct.pack("<i", epsg) + shape
            database.execute(f'INSERT INTO "{name}" (geom) VALUES (?)', (blob,))
    database.close()
    return path
