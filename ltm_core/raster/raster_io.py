"""Writes GeoTIFF files. Reading stands beside each raster's type (for elevation: `dem_io`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.errors import RasterError
from ltm_core.grid import GridGeometry

_BLOCK = 256
_CACHE_MB = 64
"""GDAL's own default is a twentieth of the machine's memory."""


def write_geotiff(
    path: Path | str,
    array: NDArray[np.generic],
    geometry: GridGeometry,
    nodata: float | None = None,
    colormap: Mapping[int, tuple[int, int, int]] | None = None,
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write an (H, W) or (bands, H, W) array as a tiled, deflated GeoTIFF.

    `colormap`: value -> RGB, for uint8 rasters. The bytes depend on the arguments alone. Raises RasterError where
    the geometry has no CRS or does not fit the array, OSError where the file cannot be written.
    """
    import rasterio
    from rasterio.io import MemoryFile
    from rasterio.windows import Window

    if geometry.crs is None:
        raise RasterError(f"{path}: a GeoTIFF needs a CRS, but this raster is in a bare map frame")
    bands = array if array.ndim == 3 else array[None]
    if bands.shape[1:] != geometry.shape:
        raise RasterError(f"{path}: array of {bands.shape[1:]} does not fit a raster of {geometry.shape}")
    predictor = 3 if np.issubdtype(array.dtype, np.floating) else 2
    options: dict[str, Any] = {
        "driver": "GTiff",
        "width": geometry.width,
        "height": geometry.height,
        "count": len(bands),
        "dtype": array.dtype,
        "crs": geometry.crs,
        "transform": geometry.transform(),
        "nodata": nodata,
        "tiled": True,
        "blockxsize": _BLOCK,
        "blockysize": _BLOCK,
        "compress": "deflate",
        "predictor": predictor,
    }
    # GDAL keeps the errors of a disk that fills up while it writes to itself, and leaves half a file.
    with rasterio.Env(GDAL_CACHEMAX=_CACHE_MB), MemoryFile() as memory:
        with memory.open(**options) as sink:
            # Strip after strip, every band of it: a block that left the cache half written would be written twice.
            for row in range(0, geometry.height, _BLOCK):
                strip = bands[:, row : row + _BLOCK]
                sink.write(strip, window=Window(0, row, geometry.width, strip.shape[1]))
            if colormap is not None:
                sink.write_colormap(1, {value: (*rgb, 255) for value, rgb in colormap.items()})
            if tags:
                sink.update_tags(**tags)
        Path(path).write_bytes(memory.getbuffer())
