"""Hold a digital elevation model (DEM): read it from files of any format, and sample it bilinearly."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.geodesy import (
    SiteFrame,
    ellipsoidal_problem,
    horizontal,
    map_problem,
    name_of,
    read_crs,
    same_crs,
    scale_problem,
)
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.heights_check import HeightsDoubt, clean_heights, doubt_of_relief, elevation_band, unit_of
from ltm_core.raster.prepared_heights_io import map_heights, write_heights
from ltm_core.raster.raster_io import check_size, open_raster, read_band, write_geotiff

Bounds = tuple[float, float, float, float]

_DEGREE = 111_000.0
"""One degree of latitude in metres."""
_ROWS = 256
"""Number of rows read at a time, or the height of the file's blocks if that is larger."""


@dataclass(frozen=True)
class StoredHeights:
    """The band of an open raster that has its elevations."""

    source: Any
    path: Path | str
    band: int
    unit: float
    """Unit of the stored values in metres."""
    crs: CRS
    doubts: list[HeightsDoubt]

    @classmethod
    def of(cls, source: Any, path: Path | str, given: str | None, ellipsoidal: bool = False) -> "StoredHeights":
        """`ellipsoidal`: whether heights above the ellipsoid are allowed. Raises RasterError if the file has no heights
        in a known unit above sea level, or no CRS."""
        crs, vertical = _crs_of(source.crs, given, path, ellipsoidal)
        band, doubts = elevation_band(source, path)
        return cls(source, path, band, unit_of(source, band, vertical, path), crs, doubts)

    @property
    def resolution(self) -> float:
        """Return the cell size in metres, roughly."""
        return float(abs(self.source.transform.a)) * (1 if self.crs.is_projected else _DEGREE)

    def read(
        self, row0: int = 0, col0: int = 0, height: int | None = None, width: int | None = None, ground: bool = True
    ) -> Float32Array:
        """Return a window in metres, NaN where unknown, north up if it is the whole. `ground`: whether they must have
        the relief of ground. Raises RasterError for heights that are no ground's."""
        height, width = height or self.source.height, width or self.source.width
        check_size(self.source, self.path, height, width)
        elevation = np.empty((height, width), np.float32)
        self.fill(elevation, row0, col0)
        return self.judged(elevation) if ground else elevation

    def fill(self, elevation: Float32Array, row0: int = 0, col0: int = 0) -> None:
        """Read strip by strip, so that only the result is held as a whole. Raises RasterError: impossible heights."""
        from rasterio.windows import Window

        source, (height, width) = self.source, elevation.shape
        scale, offset = (v[self.band - 1] * self.unit for v in (source.scales, source.offsets))
        blocks = source.block_shapes[self.band - 1][0]
        rows = max(blocks, _ROWS // blocks * blocks)
        for start in range(0, height, rows):
            count = min(rows, height - start)
            values, unknown = read_band(source, self.band, Window(col0, row0 + start, width, count))
            strip = elevation[start : start + count]
            with np.errstate(over="ignore"):
                strip[...] = values if (scale, offset) == (1.0, 0.0) else values.astype(np.float64) * scale + offset
            strip[unknown | ~np.isfinite(strip)] = np.nan
        self.doubts.extend(clean_heights(elevation, self.resolution, self.path))
        if source.transform.e > 0:  # south-up
            for row in range(height // 2):
                elevation[[row, -1 - row]] = elevation[[-1 - row, row]]

    def judged(self, elevation: Float32Array) -> Float32Array:
        """Return heights that were read. Raises RasterError if their relief is no ground's."""
        doubt = doubt_of_relief(elevation, self.resolution, self.source.dtypes[self.band - 1] == "uint8", self.path)
        self.doubts.extend([] if doubt is None else [doubt.required()])
        return elevation


def prepare_heights(path: Path | str, crs: str | None = None) -> Path | None:
    """Decode a large raster once for later reads; return the file, None if it exists already or is not needed.

    Raises RasterError: not readable; OSError: no file can be written beside it."""
    with open_raster(path) as source:
        check_size(source, path, source.height, source.width)
        return write_heights(path, source, StoredHeights.of(source, path, crs).fill)


def read_around(
    path: Path | str, crs: str | None, target: str, bounds: Bounds
) -> tuple[Float32Array, GridGeometry, tuple[HeightsDoubt, ...]]:
    """Read elevations as `Dem.open` does, over `bounds` (x_min, y_min, x_max, y_max) in the CRS `target`, warped
    bilinearly if their own grid differs; degrees are allowed.

    Raises RasterError: not readable, no CRS, or nothing of it within the bounds."""
    from rasterio import Affine
    from rasterio.enums import Resampling
    from rasterio.warp import calculate_default_transform, reproject, transform_bounds
    from rasterio.windows import Window

    with open_raster(path) as source:
        heights = StoredHeights.of(source, path, crs)
        t, there = source.transform, read_crs(target)
        upright = not (t.b or t.d) and t.a > 0 and t.e < 0
        if same_crs(heights.crs, there) and upright and np.isclose(t.a, -t.e, rtol=1e-6):
            own = GridGeometry(t.c, t.f, t.a, source.width, source.height, target)
            part = _part_within(own, bounds, path)
            row, col = (round(float(v)) for v in own.to_grid(*part.to_map(0, 0)))
            return heights.read(row, col, part.height, part.width), part, tuple(heights.doubts)
        stated, wanted = heights.crs.to_wkt(), there.to_wkt()
        onto, width, height = calculate_default_transform(stated, wanted, source.width, source.height, *source.bounds)
        resolution = math.sqrt(abs(onto.a * onto.e))
        whole = GridGeometry(onto.c, onto.f, resolution, width, height, target)
        part = _part_within(whole, bounds, path)
        check_size(source, path, part.height, part.width)
        # It is read before it is interpolated, so that values that are no heights do not get into others.
        row0, col0, rows, cols = (
            _window(source, transform_bounds(wanted, stated, *part.bounds)) if upright else (0,) * 4
        )
        read = heights.read(row0, col0, rows, cols)
        t = source.window_transform(Window(col0, row0, read.shape[1], read.shape[0]))
        if t.e > 0:
            t = Affine(t.a, -t.b, t.c + t.b * len(read), t.d, -t.e, t.f + t.e * len(read))
        elevation = np.full(part.shape, np.nan, np.float32)
        given = {"src_transform": t, "src_crs": stated, "src_nodata": np.nan, "resampling": Resampling.bilinear}
        into = {"dst_transform": part.transform(), "dst_crs": wanted, "dst_nodata": np.nan}
        reproject(read, elevation, **given, **into)
    return elevation, part, tuple(heights.doubts)


def _window(source: Any, bounds: Bounds) -> tuple[int, int, int, int]:
    """Return first row and column, height and width of what `bounds` touch, with a margin of two cells; zeros for all
    of it."""
    t, (x_min, y_min, x_max, y_max) = source.transform, bounds
    if not np.isfinite(bounds).all() or x_max <= x_min:
        return 0, 0, 0, 0
    row0, col0 = max(0, math.floor((y_max - t.f) / t.e) - 2), max(0, math.floor((x_min - t.c) / t.a) - 2)
    rows = min(source.height, math.ceil((y_min - t.f) / t.e) + 2) - row0
    cols = min(source.width, math.ceil((x_max - t.c) / t.a) + 2) - col0
    return (row0, col0, rows, cols) if min(rows, cols) > 0 else (0, 0, 0, 0)


def _part_within(whole: GridGeometry, bounds: Bounds, path: Path | str) -> GridGeometry:
    """Return the cells of `whole` that `bounds` touch."""
    x_min, y_min, x_max, y_max = bounds
    row0, col0 = (max(0, int(v)) for v in whole.cell_of(x_min, y_max))
    row1, col1 = (int(v) for v in whole.cell_of(x_max, y_min))
    row1, col1 = min(row1, whole.height - 1), min(col1, whole.width - 1)
    if row1 <= row0 or col1 <= col0:
        raise RasterError(
            f"{path}: covers {tuple(round(v) for v in whole.bounds)} in {whole.crs}, which does not overlap "
            f"{tuple(round(v) for v in bounds)}; give a DEM of this site"
        )
    return whole.window(row0, col0, row1 - row0 + 1, col1 - col0 + 1)


def _crs_of(stated: object, given: str | None, path: Path | str, ellipsoidal: bool = False) -> tuple[CRS, float | None]:
    """Return the horizontal CRS, which is compared with a site's, and the unit of stated heights in metres."""
    try:
        named = None if given is None else read_crs(given)
        crs = named if stated is None else read_crs(stated)
    except ConfigError as error:
        raise RasterError(f"{path}: {error}") from error
    if crs is None:
        raise RasterError(f"{path}: the raster has no CRS; give it with --crs or `dem: {{crs: EPSG:...}}`")
    if named is not None and not same_crs(named, crs):
        raise RasterError(f"{path}: the raster is in {crs.name}, but {given} was given")
    problem = ellipsoidal_problem(crs) or (named is not None and ellipsoidal_problem(named))
    if problem and not ellipsoidal:
        raise RasterError(f"{path}: {problem}")
    vertical = crs.axis_info[2:]
    if vertical and vertical[0].direction == "down":
        raise RasterError(f"{path}: {crs.name} states depths, not heights; negate them (gdal_calc)")
    return horizontal(crs), float(vertical[0].unit_conversion_factor) if vertical else None


@dataclass(frozen=True, eq=False)
class Dem:
    """An elevation raster with its geometry.

    `elevation`: (H, W) float32, metres, north up, NaN where unknown; values sit at cell centres and the surface is
    bilinear between them. `doubts`: what may be wrong with the file. Raises RasterError when shape and geometry
    disagree or no height is known."""

    elevation: Float32Array
    geometry: GridGeometry
    doubts: tuple[HeightsDoubt, ...] = ()

    def __post_init__(self) -> None:
        elevation = np.ascontiguousarray(self.elevation, np.float32)
        if elevation.shape != self.geometry.shape:
            raise RasterError(f"elevation of shape {elevation.shape} does not fit a raster of {self.geometry.shape}")
        if min(elevation.shape) < 2:
            raise RasterError(f"a DEM needs at least 2 x 2 heights to span a surface, got {elevation.shape}")
        if not any(np.isfinite(row).any() for row in elevation):  # no mask of the whole raster
            raise RasterError("the DEM has no height: every cell is nodata")
        object.__setattr__(self, "elevation", elevation)

    @property
    def levels(self) -> "tuple[Dem, ...]":
        """Return the rasters that the terrain consists of, finest first: of a single one, itself (see `dem_stack`)."""
        return (self,)

    @classmethod
    def open(cls, path: Path | str, crs: str | None = None) -> "Dem":
        """Read the elevations of any raster that GDAL reads, of any numeric dtype, in metres, unknown ones as NaN.

        `crs`: the CRS of a raster that carries none; giving one that contradicts the file's is an error. Rows stored
        south-up are turned. Raises RasterError: not readable, no CRS, one that is no map's or distorts distances,
        rotated, cells not square, or values that are no heights (see `heights_check`). The prepared heights of a
        large raster are mapped (see `prepared_heights_io`)."""
        with open_raster(path) as source:
            heights = StoredHeights.of(source, path, crs)
            t, problem = source.transform, map_problem(heights.crs)
            if problem is None and (t.b or t.d):
                problem = f"rotated raster {tuple(t)[:6]}; warp it north-up first (gdalwarp)"
            elif problem is None and (not np.isclose(abs(t.a), abs(t.e), rtol=1e-6) or t.a <= 0):
                problem = f"cells must be square, got {t.a} x {t.e} m; warp it first (gdalwarp -tr)"
            if problem is None:
                y_max = t.f if t.e < 0 else t.f + source.height * t.e
                geometry = GridGeometry(t.c, y_max, t.a, source.width, source.height, name_of(heights.crs))
                problem = scale_problem(heights.crs, geometry)
            if problem is not None:
                raise RasterError(f"{path}: {problem}")
            prepared = map_heights(path, source)
            elevation = heights.read() if prepared is None else heights.judged(prepared)
            return cls(elevation, geometry, tuple(heights.doubts))

    def in_frame(self, frame: SiteFrame) -> "Dem":
        """Return the same DEM in a site's map frame (CRS minus origin). Raises RasterError where the CRSs differ."""
        crs = self.geometry.crs
        if not same_crs(crs, frame.crs):
            raise RasterError(
                f"DEM is in {crs}, the site in {frame.crs}: warp it once with gdalwarp -r bilinear -t_srs {frame.crs}"
            )
        return Dem(self.elevation, self.geometry.translated(-frame.x_origin, -frame.y_origin), self.doubts)

    def elevation_at(self, x: ArrayLike, y: ArrayLike) -> Float64Array:
        """Return the bilinear height at map points, metres; NaN outside the outermost cell centres and beside
        nodata."""
        row, col = self.geometry.to_grid(x, y)
        height, width = self.elevation.shape
        inside = (row >= 0) & (row <= height - 1) & (col >= 0) & (col <= width - 1)
        r0 = np.minimum(np.where(inside, row, 0).astype(np.int32), height - 2)
        c0 = np.minimum(np.where(inside, col, 0).astype(np.int32), width - 2)
        down, east = row - r0, col - c0
        z, at, west = self.elevation.reshape(-1), r0 * np.int64(width) + c0, 1 - east
        north = west * z.take(at) + east * z[1:].take(at)
        south = west * z[width:].take(at) + east * z[width + 1 :].take(at)
        return np.where(inside, (1 - down) * north + down * south, np.nan)

    def save(self, path: Path | str) -> None:
        """Write a deflated float32 GeoTIFF. Raises RasterError when the DEM is in no named CRS."""
        write_geotiff(path, self.elevation, self.geometry, nodata=float("nan"))
