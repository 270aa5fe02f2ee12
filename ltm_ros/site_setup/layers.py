"""Make the rasters of a site from source files: the DEM and the coarser one, the surface, and the fuel map."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from ltm_core.base.errors import RasterError
from ltm_core.fuel.fuel_bands_io import quantity_of
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import CANOPY_BANDS, PriorConfig, load_prior
from ltm_core.geometry.geodesy import name_of, read_crs, same_crs
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Bounds, Dem
from ltm_core.raster.heights_check import doubt_of_surface
from ltm_ros.site_setup.rasters import Tile, grid_over, overlapping, resample, site_resolution, tiles_of
from ltm_ros.site_setup.request import Fetched
from ltm_ros.site_setup.vertical import Datum, named_datum

_MOST_PER_SIDE = 8192
"""Maximum number of cells per side of a site's DEM: 256 MB in memory."""
_FINE = 2.0
"""Cells at most this many times as large as the smallest ones belong to the fine DEM."""
_UNITS = {"cover": "%", "height": "m x 10", "base_height": "m x 10", "bulk_density": "kg/m3 x 100"}


@dataclass(frozen=True)
class Layer:
    """A raster of a site, in a file or folder. `described`: resolution, source and year. `remarks`: possible errors."""

    path: Path
    described: str
    remarks: tuple[str, ...] = ()


def local(paths: Sequence[Path]) -> Fetched:
    """Return the user's own files in the form of fetched ones."""
    return Fetched(tuple(paths), ", ".join(path.name for path in paths), "", None, None, ())


def elevation_tiles(data: Fetched) -> list[Tile]:
    """Return the tiles of an elevation source. Raises RasterError as `tiles_of` does."""
    return tiles_of(data.files, named_datum(data.vertical_crs) if data.vertical_crs else None)


def fine_tiles(tiles: Sequence[Tile], bounds: Bounds, crs: str) -> list[Tile]:
    """Return the tiles of the fine DEM over bounds in `crs`. Raises RasterError if none is there."""
    there = overlapping(tiles, bounds, crs)
    return [tile for tile in there if tile.resolution <= _FINE * there[0].resolution]


def write_dem(
    path: Path, data: Fetched, tiles: Sequence[Tile], bounds: Bounds, crs: str, datum: Datum | None, least: float = 0.0
) -> Layer:
    """Write the heights over `bounds` (in `crs`) as a DEM. `least`: smallest cell size in metres.

    Raises RasterError as `overlapping` and `resample` do, OSError if the file cannot be written."""
    there = overlapping(tiles, bounds, crs)
    boxes = [Transformer.from_crs(tile.crs, crs, always_xy=True).transform_bounds(*tile.bounds) for tile in there]
    west, south, _, _ = np.maximum(bounds, np.min(boxes, axis=0)).tolist()
    _, _, east, north = np.minimum(bounds, np.max(boxes, axis=0)).tolist()
    wanted, bounds = bounds, (west, south, east, north)  # as far as the box around all tiles reaches
    size = max(least, site_resolution(there, max(bounds[2] - bounds[0], bounds[3] - bounds[1]), _MOST_PER_SIDE))
    grid = grid_over(bounds, size, there, crs)
    heights, found = resample(there, grid, datum)
    remarks = list(found)
    covered, asked = (math.prod(box[k + 2] - box[k] for k in (0, 1)) for box in (bounds, wanted))
    if (share := np.isfinite(heights).mean() * covered / asked) < 0.99:
        remarks.append(f"{path.name}: {data.source} covers {share:.1%} of the area; terrain beyond is unknown")
    if any(tile.datum is None for tile in there):
        taken = "those of the other rasters" if datum is None else datum.name
        remarks.append(
            f"{path.name}: {data.source} states no vertical datum; its heights are taken as {taken}, which may be "
            "1 m off, or 20 to 50 m if they are ellipsoidal"
        )
    kept = len(there) == 1 and same_crs(there[0].crs, crs) and math.isclose(there[0].dx, size)
    how = "cells of the source" if kept else f"bilinear, standard error {_interpolation_error(heights):.2f} m"
    _write(path, heights, grid, data, datum, how)
    return Layer(path, f"{_described(data, size)}, {how}", tuple(remarks))


def _interpolation_error(heights: NDArray[np.float32]) -> float:
    """Return the standard error of interpolated heights in metres: a quarter of the second differences, which is what
    bilinear heights between cell centres are off on ground of the same roughness."""
    bend = heights[:, 1:-1] - (heights[:, :-2] + heights[:, 2:]) / 2
    bend = bend[np.isfinite(bend)]
    return float(np.sqrt(np.mean(np.square(bend, dtype=np.float64)))) / 4 if bend.size else math.nan


def write_surface(path: Path, data: Fetched, bounds: Bounds, crs: str, datum: Datum | None, ground: Dem) -> Layer:
    """Write the elevation of the tops of trees and buildings. Heights above the ground are added to `ground` (in
    `crs`). Raises as `write_dem` does."""
    tiles = overlapping(elevation_tiles(data), bounds, crs)
    size = site_resolution(tiles, max(bounds[2] - bounds[0], bounds[3] - bounds[1]), _MOST_PER_SIDE)
    grid = grid_over(bounds, size, tiles, crs)
    heights, remarks = resample(tiles, grid, datum, elevation=False)
    cols = np.arange(grid.width)
    under = np.array([ground.elevation_at(*grid.to_map(row, cols)) for row in range(grid.height)], np.float32)
    above = data.above_ground or (all(tile.datum is None for tile in tiles) and _above_ground(heights, under, path))
    if above:
        heights = under + np.maximum(heights, 0)
    _write(path, heights, grid, data, datum)
    what = "canopy height above the DEM" if above else "surface"
    return Layer(path, f"{_described(data, size)}, {what}", remarks)


def _above_ground(heights: NDArray[np.float32], ground: NDArray[np.float32], path: Path) -> bool:
    """Return whether heights are those above the ground, by their values. Raises RasterError if they are neither."""
    known = np.isfinite(heights) & np.isfinite(ground)
    if not known.any():
        raise RasterError(f"{path.name}: the surface has no cell over the DEM; give a surface of the site")
    low, high = np.quantile(heights[known], (0.02, 0.98))
    if low > -5 and high < 120 and float(np.median(heights[known])) < float(np.median(ground[known])) - 5:
        return True
    doubt = doubt_of_surface(heights.astype(np.float64), ground.astype(np.float64), path.name)
    if doubt is not None:
        doubt.required()
    return False


def write_fuel(folder: Path, data: Fetched, grid: GridGeometry) -> Layer:
    """Write fuel codes and canopy on a grid in the site's CRS, by nearest cell, one file each in a new folder.

    Raises RasterError as `load_prior` does, OSError if a file cannot be written."""
    prior = load_prior(_prior_of(data.files).model_copy(update={"own_fbfm13": "as_given"}), grid)
    folder.mkdir()
    bands: dict[str, NDArray[np.int16]] = {prior.system.value: prior.codes}
    if prior.fbfm13 is not None:
        bands["fbfm13"] = prior.fbfm13
    canopy = zip(CANOPY_BANDS, () if prior.canopy is None else prior.canopy, strict=False)
    bands |= {name: values for name, values in canopy if (values != NODATA).any()}
    for name, values in bands.items():
        _write(folder / f"{name}.tif", values, grid, data, how="nearest")
    known = float((prior.codes != NODATA).mean())
    remarks = list(prior.remarks)
    if known < 0.995:
        remarks.append(f"{folder.name}: {data.source} covers {known:.0%} of the area; the rest is unknown")
    return Layer(folder, f"{', '.join(bands)}; {_described(data, grid.resolution)}", tuple(remarks))


def _prior_of(files: Sequence[Path]) -> PriorConfig:
    if len(files) == 1:
        return PriorConfig(path=files[0])
    named = {quantity_of(path) or "": path for path in files}
    known = {name: path for name, path in named.items() if name in PriorConfig.model_fields}
    if not known.keys() & {"fbfm40", "fbfm13"} or len(named) < len(files):
        raise RasterError(
            f"{', '.join(path.name for path in files)}: unclear which has the fuel codes; give a landscape, one "
            "raster of codes, or a folder with files such as fbfm40.tif and cover.tif"
        )
    return PriorConfig.model_validate(known)


def _described(data: Fetched, size: float) -> str:
    parts = [f"{size:g} m, {data.source}", "" if data.year is None else f"{data.year}", data.licence]
    return ", ".join(part for part in parts if part)


def _write(
    path: Path, values: NDArray[Any], grid: GridGeometry, data: Fetched, datum: Datum | None = None, how: str = ""
) -> None:
    """Write heights (floats, above `datum`) or a band of the fuel map as a cloud-optimised GeoTIFF with provenance.
    `how`: of the resampling."""
    import rasterio
    import rasterio.shutil
    from rasterio.io import MemoryFile

    tags = {
        "SOURCE": data.source,
        "LICENCE": data.licence or "unknown",
        "YEAR": "unknown" if data.year is None else str(data.year),
        "URLS": " ".join(data.urls) or " ".join(file.name for file in data.files),
        "SOFTWARE": "ltm init",
    }
    tags |= {"RESAMPLING": how} if how else {}
    if heights := values.dtype.kind == "f":
        tags["VERTICAL_DATUM"] = "unknown" if datum is None else f"{datum.name} ({datum.code})"
    options = {
        "driver": "GTiff", "width": grid.width, "height": grid.height, "count": 1, "dtype": values.dtype,
        "crs": compound(grid.crs or "", datum), "transform": grid.transform(), "nodata": np.nan if heights else NODATA,
    }  # fmt: skip
    layout = {"compress": "deflate", "predictor": "yes", "blocksize": 256, "bigtiff": "if_safer"}
    overviews = {"overview_resampling": "average" if heights else "nearest"}
    # GDAL hides the error of a full disk when it writes to one itself, and leaves half a file.
    with rasterio.Env(GDAL_CACHEMAX=64), MemoryFile() as plain, MemoryFile(ext=".tif") as packed:
        with plain.open(**options) as sink:
            sink.write(values, 1)
            sink.set_band_description(1, path.stem)
            sink.set_band_unit(1, "metre" if heights else _UNITS.get(path.stem, ""))
            sink.update_tags(**tags)
        rasterio.shutil.copy(plain.name, packed.name, driver="COG", **layout, **overviews)
        path.write_bytes(packed.getbuffer())


def compound(crs: str, datum: Datum | None) -> str:
    """Return a site's CRS with the vertical datum of its heights; without it if one of them has no EPSG code."""
    code = "" if datum is None else datum.code
    if crs.startswith("EPSG:") and code.startswith("EPSG:"):
        return f"{crs}+{code.removeprefix('EPSG:')}"
    return name_of(read_crs(crs))
