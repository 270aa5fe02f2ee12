"""Read rasters of any CRS as tiles, and resample their heights to a site's grid.

Tiles on one grid are joined before they are interpolated, so that there is no seam between them. Heights are bilinear
between cell centres; GDAL gives rasters that are registered to points the edges of the cells around these points.
Positions are PROJ's at nodes at most `_LATTICE` metres apart; between the nodes their error is below 2 mm."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from pyproj import CRS, Transformer

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.geodesy import horizontal, read_crs, same_crs
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Bounds, StoredHeights
from ltm_core.raster.heights_check import unit_of
from ltm_core.raster.raster_io import open_raster
from ltm_core.storage.disk_io import is_folder
from ltm_ros.site_setup.request import METRES_PER_DEGREE
from ltm_ros.site_setup.vertical import Datum, MissingGridError, correction, datum_of

_SUFFIXES = (".tif", ".tiff", ".img", ".asc", ".hgt", ".vrt", ".bil", ".dem", ".dt1", ".dt2", ".nc", ".jp2")
_LATTICE = 250.0
_ROWS = 256
"""Number of rows that are interpolated at a time."""
_SIZES = (0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 15.0, 20.0, 30.0, 60.0, 90.0)
"""Cell sizes in metres of a site's rasters."""
MOST_CELLS = 190_000_000
"""Maximum number of cells of an area that are fetched or joined: 17.3 km per side at 1 m."""


@dataclass(frozen=True)
class Tile:
    """A raster file: the outer edges of its north-western corner and its cell size, in its horizontal CRS."""

    path: Path
    crs: CRS
    datum: Datum | None
    west: float
    north: float
    dx: float
    dy: float
    width: int
    height: int

    @property
    def bounds(self) -> Bounds:
        return self.west, self.north - self.height * self.dy, self.west + self.width * self.dx, self.north

    @property
    def resolution(self) -> float:
        """Return the mean cell size in metres."""
        if self.crs.is_geographic:
            along = math.cos(math.radians(self.north - self.height * self.dy / 2))
            return METRES_PER_DEGREE * math.sqrt(self.dx * self.dy * along)
        return math.sqrt(self.dx * self.dy) * float(self.crs.axis_info[0].unit_conversion_factor)

    def fits(self, other: "Tile") -> bool:
        """Return whether the cells of both tiles belong to one grid, within a hundredth of a cell."""
        apart = ((self.west - other.west) / self.dx, (self.north - other.north) / self.dy)
        sizes = (other.dx / self.dx - 1) * max(self.width, 1), (other.dy / self.dy - 1) * max(self.height, 1)
        whole = all(abs(cells - round(cells)) < 0.01 for cells in apart)
        return (
            whole and max(abs(v) for v in sizes) < 0.01 and self.datum == other.datum and same_crs(self.crs, other.crs)
        )


def files_of(paths: Iterable[Path]) -> list[Path]:
    """Return the raster files of paths, of which some may be folders. Raises RasterError for a folder without any."""
    found: list[Path] = []
    for path in paths:
        if not is_folder(path):
            found.append(path)
            continue
        inside = sorted(file for file in path.rglob("*") if file.suffix.lower() in _SUFFIXES)
        if not inside:
            raise RasterError(f"{path}: has no raster ({', '.join(_SUFFIXES)}); name the files")
        found += inside
    return found


def tiles_of(paths: Iterable[Path], datum: Datum | None = None) -> list[Tile]:
    """Read what raster files state about themselves. `datum`: of heights in files that do not state theirs.

    Raises RasterError: not readable, no CRS, or rotated."""
    tiles = []
    for path in files_of(paths):
        with open_raster(path) as source:
            t = source.transform
            if source.crs is None:
                raise RasterError(f"{path}: the raster has no CRS; state it: rio edit-info --crs EPSG:CODE {path}")
            if t.b or t.d or t.a <= 0:
                raise RasterError(f"{path}: rotated raster {tuple(t)[:6]}; warp it north-up first (gdalwarp)")
            crs = read_crs(source.crs)
            north = t.f if t.e < 0 else t.f + source.height * t.e
            stated = datum_of(crs) or datum
            tiles.append(Tile(path, horizontal(crs), stated, t.c, north, t.a, abs(t.e), source.width, source.height))
    return tiles


def overlapping(tiles: Sequence[Tile], bounds: Bounds, crs: str) -> list[Tile]:
    """Return the tiles that `bounds` (x_min, y_min, x_max, y_max) in `crs` touch, finest first. Raises RasterError if
    there is none."""
    found = []
    for tile in tiles:
        west, south, east, north = tile.bounds
        x_min, y_min, x_max, y_max = Transformer.from_crs(crs, tile.crs, always_xy=True).transform_bounds(*bounds)
        if x_min < east and x_max > west and y_min < north and y_max > south:
            found.append(tile)
    if not found:
        covered = [Transformer.from_crs(t.crs, "EPSG:4326", always_xy=True).transform_bounds(*t.bounds) for t in tiles]
        west, south, east, north = (f(v) for f, v in zip((min, min, max, max), zip(*covered, strict=True), strict=True))
        raise RasterError(
            f"{tiles[0].path}: {len(tiles)} files cover longitudes {west:.3f} to {east:.3f} and latitudes {south:.3f} "
            f"to {north:.3f}, which is not where the site is; give rasters of the site"
        )
    return sorted(found, key=lambda tile: tile.resolution)


def site_resolution(tiles: Sequence[Tile], side: float, most: int) -> float:
    """Return the cell size in metres for tiles: the usual one nearest to that of the finest, such that a square of
    `side` metres has at most `most` cells per side."""
    finest = min(tile.resolution for tile in tiles)
    near = min(_SIZES, key=lambda size: abs(math.log(size / finest)))
    return next((size for size in _SIZES if size >= max(near, side / most)), math.ceil(side / most))


def grid_over(bounds: Bounds, resolution: float, tiles: Sequence[Tile], crs: str) -> GridGeometry:
    """Return the grid over bounds in `crs`, with the cells of the first tile if it has that CRS and cell size."""
    x_min, y_min, x_max, y_max = bounds
    first = tiles[0]
    own = same_crs(first.crs, crs) and math.isclose(first.dx, resolution) and math.isclose(first.dy, resolution)
    x, y = (first.west, first.north) if own else (0.0, 0.0)
    left, right = math.floor((x_min - x) / resolution), math.ceil((x_max - x) / resolution)
    up, down = math.ceil((y_max - y) / resolution), math.floor((y_min - y) / resolution)
    return GridGeometry(x + left * resolution, y + up * resolution, resolution, right - left, up - down, crs)


def resample(
    tiles: Sequence[Tile], grid: GridGeometry, datum: Datum | None, elevation: bool = True
) -> tuple[Float32Array, tuple[str, ...]]:
    """Return the heights of tiles on a grid, in the vertical datum of the site, NaN where unknown; and remarks for the
    user. Where tiles overlap, the first one counts.

    `elevation`: whether the values are elevations; else heights above the ground. Raises RasterError: values that are
    no heights, too many cells, or ellipsoidal heights that PROJ has no grid for."""
    result = np.full(grid.shape, np.nan, np.float32)
    remarks: list[str] = []
    joined = [_joined(group, grid, elevation, remarks) for group in _groups(tiles)]
    places = [_places(grid, tile, datum, remarks) for tile, _ in joined]
    for strict in (True, False):  # beside unknown cells and at edges only where no other tile is whole
        for (tile, values), placed in zip(joined, places, strict=True):
            for row in range(0, grid.height, _ROWS):
                part = result[row : row + _ROWS]
                rows, cols = np.nonzero(np.isnan(part))
                if rows.size:
                    x, y, lift = placed(rows + row, cols)
                    found = _bilinear(values, (tile.north - y) / tile.dy - 0.5, (x - tile.west) / tile.dx - 0.5, strict)
                    part[rows, cols] = found + lift
    if not np.isfinite(result).any():
        raise RasterError(f"{tiles[0].path}: has no height at the site: every cell is nodata there")
    return result, tuple(dict.fromkeys(remarks))


def _groups(tiles: Sequence[Tile]) -> list[list[Tile]]:
    groups: list[list[Tile]] = []
    for tile in tiles:
        if (group := next((group for group in groups if group[0].fits(tile)), None)) is None:
            groups.append(group := [])
        group.append(tile)
    return groups


def _joined(group: list[Tile], grid: GridGeometry, elevation: bool, remarks: list[str]) -> tuple[Tile, Float32Array]:
    """Return the part of tiles on one grid that the site's grid needs, as one tile with its heights in metres.

    Where the cells are about half as large as the site's or smaller, blocks of them are averaged."""
    first = group[0]
    step = max(1, int(grid.resolution / first.resolution + 0.1))
    bounds = Transformer.from_crs(grid.crs, first.crs, always_xy=True).transform_bounds(*grid.bounds, densify_pts=21)
    margin = 2 * step
    col0 = math.floor((bounds[0] - first.west) / first.dx) - margin
    row0 = math.floor((first.north - bounds[3]) / first.dy) - margin
    cols = math.ceil((math.ceil((bounds[2] - first.west) / first.dx) + margin - col0) / step)
    rows = math.ceil((math.ceil((first.north - bounds[1]) / first.dy) + margin - row0) / step)
    if rows * cols > MOST_CELLS:
        raise RasterError(
            f"{first.path}: {cols} x {rows} cells are too many for the site (at most {MOST_CELLS}); reduce --radius"
        )
    total, count = np.zeros((rows, cols), np.float32), np.zeros((rows, cols), np.float32)
    for tile in group:
        top = round((first.north - tile.north) / first.dy) - row0
        left = round((tile.west - first.west) / first.dx) - col0
        r0, r1 = max(0, top), min(rows * step, top + tile.height)
        c0, c1 = max(0, left), min(cols * step, left + tile.width)
        if r0 >= r1 or c0 >= c1:
            continue
        values = _read(tile, (r0 - top, c0 - left, r1 - r0, c1 - c0), elevation, remarks)
        before, behind = (r0 % step, -r1 % step), (c0 % step, -c1 % step)
        whole = np.pad(values, (before, behind), constant_values=np.nan) if step > 1 else values
        blocks = whole.reshape(whole.shape[0] // step, step, whole.shape[1] // step, step)
        known = np.isfinite(blocks).sum(axis=(1, 3), dtype=np.float32)
        at = np.s_[r0 // step : r0 // step + len(known), c0 // step : c0 // step + known.shape[1]]
        new = count[at] < known  # of overlapping tiles, the one that has more of the block
        total[at] = np.where(new, np.nansum(blocks, axis=(1, 3)), total[at])
        count[at] = np.where(new, known, count[at])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(count > step * step / 2, total / count, np.float32(np.nan))
    west, north = first.west + col0 * first.dx, first.north - row0 * first.dy
    tile = Tile(first.path, first.crs, first.datum, west, north, step * first.dx, step * first.dy, cols, rows)
    return tile, mean.astype(np.float32, copy=False)


def _read(tile: Tile, window: tuple[int, int, int, int], elevation: bool, remarks: list[str]) -> Float32Array:
    """Return first row and column, height and width of a tile, north up, in metres."""
    row, col, height, width = window
    with open_raster(tile.path) as source:
        if source.transform.e > 0:
            row = source.height - row - height
        if elevation:
            stored = StoredHeights.of(source, tile.path, None, ellipsoidal=True)
        else:
            stored = StoredHeights(source, tile.path, 1, unit_of(source, 1, None, tile.path), tile.crs, [])
        values = stored.read(row, col, height, width, ground=elevation)
    remarks += [doubt.text for doubt in stored.doubts]
    return values


def _places(
    grid: GridGeometry, tile: Tile, datum: Datum | None, remarks: list[str]
) -> Callable[[Any, Any], Float64Array]:
    """Return the function of rows and columns that gives the x and y of the site's cells in a tile's CRS, and what to
    add to heights there, (3, N)."""
    step = max(1.0, _LATTICE / grid.resolution)
    rows, cols = (np.linspace(0, n - 1, max(2, math.ceil((n - 1) / step) + 1)) for n in grid.shape)
    high, wide = (rows[1] - rows[0]) or 1.0, (cols[1] - cols[0]) or 1.0
    x, y = grid.to_map(*np.meshgrid(rows, cols, indexing="ij"))
    way = Transformer.from_crs(grid.crs, tile.crs, always_xy=True)
    if way.accuracy > 2:
        remarks.append(f"{tile.path}: {tile.crs.name} is converted to {grid.crs} within {way.accuracy:g} m")
    lift: Any = np.zeros(x.shape)
    if tile.datum is not None and datum is not None:
        lonlat = Transformer.from_crs(grid.crs, 4326, always_xy=True).transform(x, y)
        try:
            lift = correction(tile.datum, datum, *lonlat)
        except MissingGridError as error:
            if error.metres > 1:
                raise
            remarks.append(f"{tile.path}: {error}")
    nodes = [*way.transform(x, y), lift]
    return lambda row, col: np.stack(
        [scipy.ndimage.map_coordinates(v, np.stack([row / high, col / wide]), order=1, mode="nearest") for v in nodes]
    )


def _bilinear(values: Float32Array, row: Float64Array, col: Float64Array, strict: bool) -> Float64Array:
    """Return values at fractional cells; NaN beside unknown ones, or if not `strict`, where these weigh most."""
    where = np.stack([np.where(np.abs(v - np.rint(v)) < 1e-4, np.rint(v), v) for v in (row, col)])
    first = np.maximum(np.floor(where.min(axis=1, initial=np.inf)).astype(np.int64), 0)
    last = np.maximum(np.ceil(where.max(axis=1, initial=-np.inf)).astype(np.int64) + 1, first + 1)
    part = values[first[0] : last[0], first[1] : last[1]]  # the cells around these places
    if not part.size:
        return np.full(row.shape, np.nan)
    finite = np.isfinite(part)
    total, known = (
        scipy.ndimage.map_coordinates(cells, where - first[:, None], np.float64, order=1, mode="grid-constant")
        for cells in (np.where(finite, part, 0.0), finite.astype(np.float64))
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known > (1 - 1e-9 if strict else 0.5 - 1e-9), total / known, np.nan)
