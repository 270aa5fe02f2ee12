"""Lays vector layers of what does not burn (roads, water, buildings) over a fuel map."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from pyproj import Transformer

from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior_config import BarrierConfig
from ltm_core.grid import GridGeometry
from ltm_core.raster.geopackage_io import read_geopackage
from ltm_core.types import BoolArray, Float32Array, Float64Array, Int16Array

_STRIP: Final = 256
_FINE: Final = 8
"""Parts a side into which a cell is cut, to tell how much of it an area covers."""


def barrier_codes(barriers: Iterable[BarrierConfig], geometry: GridGeometry) -> Int16Array:
    """(H, W) NB1 and NB8 where the layers say so, NODATA elsewhere. Raises RasterError for a file that cannot be read,
    a layer that it lacks, or one without CRS.
    """
    codes = np.full(geometry.shape, NODATA, np.int16)
    for barrier in barriers:
        codes[_cells(barrier, geometry)] = barrier.code
    return codes


def with_barriers(codes: Int16Array, barriers: Int16Array) -> Int16Array:
    """(H, W) fuel codes with those of `barrier_codes` over them where a code is known."""
    return np.where((barriers != NODATA) & (codes != NODATA), barriers, codes)


def _cells(barrier: BarrierConfig, geometry: GridGeometry) -> BoolArray:
    """(H, W): what the barrier takes."""
    from rasterio.features import rasterize

    lines, areas = _shapes(barrier, geometry)
    taken = np.zeros(geometry.shape, np.bool_)
    if lines:
        taken |= rasterize(lines, geometry.shape, transform=geometry.transform(), all_touched=True).astype(bool)
    if areas:
        taken |= covered_share(areas, geometry) >= barrier.least_share
    return taken


def covered_share(areas: Sequence[Any], geometry: GridGeometry) -> Float32Array:
    """(H, W): how much of each cell areas cover, 0 to 1; GeoJSON geometries in the grid's CRS."""
    from rasterio.features import rasterize
    from rasterio.transform import from_origin

    share = np.zeros(geometry.shape, np.float32)
    # In strips of rows: of a large site the fine grid would take gigabytes.
    for top in range(0, geometry.height, _STRIP) if areas else ():
        strip = geometry.window(top, 0, min(_STRIP, geometry.height - top), geometry.width)
        fine = from_origin(strip.x_min, strip.y_max, strip.resolution / _FINE, strip.resolution / _FINE)
        covered = rasterize(areas, (strip.height * _FINE, strip.width * _FINE), transform=fine)
        share[top : top + strip.height] = covered.reshape(strip.height, _FINE, strip.width, _FINE).mean(axis=(1, 3))
    return share


def _shapes(barrier: BarrierConfig, geometry: GridGeometry) -> tuple[list[Any], list[Any]]:
    """Lines and areas that come near the grid, in its CRS, as GeoJSON geometries."""
    layer = read_geopackage(barrier.path, barrier.layer)
    turn = Transformer.from_crs(layer.crs, geometry.crs, always_xy=True)

    def here(points: Float64Array) -> list[tuple[float, float]]:
        x, y = turn.transform(points[:, 0], points[:, 1])
        return list(zip(np.asarray(x).tolist(), np.asarray(y).tolist(), strict=True))

    lines = [{"type": "LineString", "coordinates": here(line)} for line in layer.lines if len(line) > 1]
    areas = [
        {"type": "Polygon", "coordinates": [here(ring) for ring in rings if len(ring) > 3]}
        for rings in layer.areas
        if len(rings[0]) > 3
    ]
    return [s for s in lines if near([s["coordinates"]], geometry)], [
        a for a in areas if near(a["coordinates"], geometry)
    ]


def near(rings: Any, geometry: GridGeometry) -> bool:
    """Whether a shape's box meets the grid, and all of it could be turned into the grid's CRS."""
    points = np.concatenate([np.asarray(ring, np.float64) for ring in rings])
    if not np.isfinite(points).all():
        return False
    x_min, y_min, x_max, y_max = geometry.bounds
    (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
    return bool(left <= x_max and right >= x_min and low <= y_max and high >= y_min)
