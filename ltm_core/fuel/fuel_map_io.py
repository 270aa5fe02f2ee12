"""Reads and writes fuel maps of class indices as GeoTIFF files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.cell_counts import UNSEEN
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import check_size, open_raster, write_geotiff
from ltm_core.vision.labels import LabelSet


def write_fuel_map(
    path: Path | str,
    classes: UInt8Array,
    geometry: GridGeometry,
    labels: LabelSet,
    tags: Mapping[str, str] | None = None,
) -> Path:
    """Write class indices, (H, W) uint8 with 255 unseen, with the palette and the classes' names.

    The file appears whole or not at all. Raises ConfigError where `path` is empty, its folder is missing or the file
    cannot be written.
    """
    if not str(path):
        raise ConfigError("no file is configured for the fuel map: set the parameter export_path")
    path = Path(path)
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: the folder {path.parent} does not exist; make it first")
    partial = path.with_name(f".{path.name}.partial")
    try:
        write_geotiff(
            partial,
            classes,
            geometry,
            nodata=UNSEEN,
            colormap=dict(enumerate(labels.colors)),
            tags={"classes": json.dumps(labels.names), **(tags or {})},
        )
        partial.replace(path)
    except OSError as error:  # rasterio's own errors of opening a file among them
        partial.unlink(missing_ok=True)
        raise ConfigError(f"{path}: the fuel map cannot be written there ({error})") from error
    return path


def read_fuel_map(path: Path | str) -> tuple[UInt8Array, GridGeometry]:
    """The class indices (255 unseen) and geometry of a fuel map. Raises RasterError on any other raster."""
    with open_raster(path) as source:
        if source.dtypes[0] != "uint8" or source.crs is None:
            raise RasterError(f"{path}: a fuel map is uint8 with a CRS, this is {source.dtypes[0]}, {source.crs}")
        t = source.transform
        if t.b or t.d or t.a <= 0 or t.e != -t.a:
            raise RasterError(f"{path}: a fuel map is north-up with square cells, this has {tuple(t)[:6]}")
        geometry = GridGeometry(t.c, t.f, t.a, source.width, source.height, str(source.crs))
        check_size(source, path, source.height, source.width)
        classes = source.read(1)
        if source.nodata is not None:
            classes = np.where(classes == source.nodata, np.uint8(UNSEEN), classes)
    return classes, geometry


def resampled(
    classes: UInt8Array, geometry: GridGeometry, crs: str, phase: float = 15.0
) -> tuple[UInt8Array, GridGeometry]:
    """The map by nearest cell on the grid of the same resolution in another CRS, edges at phase mod resolution.

    EPSG:5070 gives LANDFIRE's grid. Raises ConfigError where `crs` is unknown or not projected in metres.
    """
    from rasterio.warp import Resampling, reproject, transform_bounds

    SiteFrame(crs)  # cells of 30 degrees or feet would be no map
    bounds = transform_bounds(geometry.crs, crs, *geometry.bounds)
    target = GridGeometry.snapped(bounds, geometry.resolution, phase, crs)
    result = np.full(target.shape, UNSEEN, np.uint8)
    reproject(
        classes,
        result,
        src_transform=geometry.transform(),
        src_crs=geometry.crs,
        src_nodata=UNSEEN,
        dst_transform=target.transform(),
        dst_crs=crs,
        dst_nodata=UNSEEN,
        resampling=Resampling.nearest,
    )
    return result, target
