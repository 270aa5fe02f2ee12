"""Reads real ground for a scenario: elevation and fuel codes from rasters in any CRS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import BoolArray, Float64Array, Int16Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import open_raster

_LARGEST = 200_000_000  # cells of a window


def read_elevation(path: Path, geometry: GridGeometry) -> Float64Array:
    """Elevation (H, W) at the cells of `geometry` (in its CRS), resampled by cubic convolution.

    Raises RasterError: no raster, no CRS, no elevation somewhere in the window.
    """
    values, missing = _resampled(path, geometry, "cubic")
    if np.any(missing):
        raise RasterError(
            f"{path}: no elevation in {missing.mean():.1%} of the scenario's ground (x {geometry.x_min:.0f} .. "
            f"{geometry.x_max:.0f}, y {geometry.y_min:.0f} .. {geometry.y_max:.0f} in {geometry.crs}, surroundings "
            "included); move `origin` or make terrain.size and terrain.surroundings smaller"
        )
    return values


def read_codes(path: Path, geometry: GridGeometry) -> Int16Array:
    """Fuel model numbers (H, W) at the cells of `geometry`, the nearest of the raster; -1 where it has none.

    Raises RasterError: no raster, no CRS, nothing in the window.
    """
    values, missing = _resampled(path, geometry, "nearest")
    if np.all(missing):
        raise RasterError(f"{path}: no fuel code in the scenario's ground; its CRS or `origin` must be wrong")
    return np.where(missing, -1, values).astype(np.int16)


def _resampled(path: Path, geometry: GridGeometry, method: str) -> tuple[Float64Array, BoolArray]:
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT

    if geometry.width * geometry.height > _LARGEST:
        raise RasterError(f"{path}: a window of {geometry.width} x {geometry.height} cells is too large")
    with open_raster(path) as source:
        if source.crs is None:
            raise RasterError(
                f"{path}: has no CRS, so its place is unknown; state it with gdal_edit.py -a_srs EPSG:.... {path}"
            )
        options: dict[str, Any] = {
            "crs": geometry.crs,
            "transform": geometry.transform(),
            "width": geometry.width,
            "height": geometry.height,
            "resampling": Resampling[method],
            "dtype": "float64",
            "nodata": -1e9,
        }
        with WarpedVRT(source, **options) as window:
            values = window.read(1)
    missing = (values <= -1e8) | ~np.isfinite(values)
    return values, missing
