"""Hold a digital elevation model (DEM): read it from files of any format, and sample it bilinearly."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.prepared_heights_io import map_heights, write_heights
from ltm_core.raster.raster_io import check_size, open_raster

Bounds = tuple[float, float, float, float]

_ROWS = 256
"""Number of rows read at a time, or the height of the file's blocks if that is larger."""
_TO_METRES = "convert them to metres first (feet: gdal_translate -ot Float32 -scale 0 1 0 0.3048 -a_srs EPSG:...)"


def read_heights(path: Path | str, crs: str | None) -> tuple[Float32Array, GridGeometry]:
    """Read band 1 as heights, (H, W) float32, north up, NaN where nodata, and its geometry; see `Dem.open`.

    The prepared heights of a large raster are mapped (see `prepared_heights_io`).
    """
    with open_raster(path) as source:
        stated = _crs_of(source.crs, crs, path)
        if not stated.is_projected or {axis.unit_name for axis in stated.axis_info[:2]} != {"metre"}:
            raise RasterError(
                f"{path}: a DEM must be projected in metres, {stated.name} is not; warp it first (gdalwarp)"
            )
        _check_heights(source, path)
        t = source.transform
        if t.b or t.d:
            raise RasterError(f"{path}: rotated raster {tuple(t)[:6]}; warp it north-up first (gdalwarp)")
        if not np.isclose(abs(t.a), abs(t.e), rtol=1e-6) or t.a <= 0:
            raise RasterError(f"{path}: cells must be square, got {t.a} x {t.e} m; warp it first (gdalwarp -tr)")
        prepared = map_heights(path, source)
        elevation = _read(source, path) if prepared is None else prepared
    height, width = elevation.shape
    y_max = t.f if t.e < 0 else t.f + height * t.e
    return elevation, GridGeometry(t.c, y_max, t.a, width, height, name_of(stated))


def prepare_heights(path: Path | str) -> Path | None:
    """Decode a large raster once for later reads; return the file, None if it exists already or is not needed.

    Raises RasterError: not readable; OSError: no file can be written beside it.
    """
    with open_raster(path) as source:
        check_size(source, path, source.height, source.width)
        scaling = source.scales[0], source.offsets[0]
        return write_heights(path, source, lambda heights: _fill(heights, source, 0, 0, scaling))


def read_around(path: Path | str, crs: str | None, target: str, bounds: Bounds) -> tuple[Float32Array, GridGeometry]:
    """Read band 1 as heights over `bounds` (x_min, y_min, x_max, y_max in the CRS `target`), bilinearly warped if its
    own grid differs; degrees are allowed.

    Raises RasterError: not readable, no CRS, heights not in metres, or nothing of it within the bounds.
    """
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT
    from rasterio.warp import calculate_default_transform

    with open_raster(path) as source:
        stated = _crs_of(source.crs, crs, path)
        _check_heights(source, path)
        t = source.transform
        there = CRS.from_user_input(target)
        if stated == there and not (t.b or t.d) and t.a > 0 and t.e < 0 and np.isclose(t.a, -t.e, rtol=1e-6):
            own = GridGeometry(t.c, t.f, t.a, source.width, source.height, name_of(stated))
            part = _part_within(own, bounds, path)
            row, col = (round(float(v)) for v in own.to_grid(*part.to_map(0, 0)))
            return _read(source, path, row, col, part.height, part.width), part
        onto, width, height = calculate_default_transform(
            stated.to_wkt(), there.to_wkt(), source.width, source.height, *source.bounds
        )
        resolution = math.sqrt(abs(onto.a * onto.e))
        whole = GridGeometry(onto.c, onto.f, resolution, width, height, name_of(there))
        part = _part_within(whole, bounds, path)
        with WarpedVRT(
            source,
            src_crs=stated.to_wkt(),
            crs=there.to_wkt(),
            transform=part.transform(),
            width=part.width,
            height=part.height,
            resampling=Resampling.bilinear,
            dtype="float32",
            nodata=float("nan"),
        ) as warped:
            check_size(source, path, part.height, part.width)
            return _read(warped, path, scaling=(source.scales[0], source.offsets[0])), part


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


def _read(
    source: Any,
    path: Path | str,
    row0: int = 0,
    col0: int = 0,
    height: int | None = None,
    width: int | None = None,
    scaling: tuple[float, float] | None = None,
) -> Float32Array:
    """Return a window of band 1; its size is checked where it is not the whole of a warped raster (`scaling`)."""
    height, width = height or source.height, width or source.width
    if scaling is None:
        check_size(source, path, height, width)
    elevation = np.empty((height, width), np.float32)
    _fill(elevation, source, row0, col0, scaling or (source.scales[0], source.offsets[0]))
    return elevation


def _fill(elevation: Float32Array, source: Any, row0: int, col0: int, scaling: tuple[float, float]) -> None:
    """Reduce strip by strip, so that only the result is held as a whole."""
    from rasterio.windows import Window

    (height, width), (scale, offset) = elevation.shape, scaling
    blocks = source.block_shapes[0][0]
    rows = max(blocks, _ROWS // blocks * blocks)
    for start in range(0, height, rows):
        count = min(rows, height - start)
        band = source.read(1, window=Window(col0, row0 + start, width, count), masked=True)
        strip = elevation[start : start + count]
        strip[...] = band.data
        if (scale, offset) != (1.0, 0.0):
            strip[...] = band.data.astype(np.float64) * scale + offset
        if band.mask is not np.ma.nomask:
            strip[band.mask] = np.nan
        strip[~np.isfinite(strip)] = np.nan
    if source.transform.e > 0:
        _turn(elevation)


def _turn(elevation: Float32Array) -> None:
    """South-up to north-up, in place."""
    for row in range(len(elevation) // 2):
        north = elevation[row].copy()
        elevation[row], elevation[-1 - row] = elevation[-1 - row], north


def _check_heights(source: Any, path: Path | str) -> None:
    if np.issubdtype(np.dtype(source.dtypes[0]), np.complexfloating):
        raise RasterError(f"{path}: band 1 is {source.dtypes[0]}; elevation must be a real number")
    if re.search(r"f(oo|ee)?t", source.units[0] or "", re.IGNORECASE):
        raise RasterError(f"{path}: heights are in {source.units[0]}; {_TO_METRES}")


def _crs_of(stated: object, given: str | None, path: Path | str) -> CRS:
    """Return the horizontal CRS: what a site is compared with; a stated height system is only checked to be in
    metres."""
    from pyproj.exceptions import CRSError

    try:
        named = None if given is None else CRS.from_user_input(given)
    except CRSError as error:
        raise RasterError(f"{path}: unknown CRS {given!r}: give an EPSG code such as EPSG:32611 ({error})") from error
    crs = named if stated is None else CRS.from_user_input(stated)
    if crs is None:
        raise RasterError(f"{path}: the raster has no CRS; give it with --crs or `dem: {{crs: EPSG:...}}`")
    for axis in crs.axis_info[2:]:
        if axis.unit_name != "metre":
            raise RasterError(f"{path}: heights of {crs.name} are in {axis.unit_name}; {_TO_METRES}")
    crs = horizontal(crs)
    if named is not None and horizontal(named) != crs:
        raise RasterError(f"{path}: the raster is in {crs.name}, but {given} was given")
    return crs


def horizontal(crs: CRS) -> CRS:
    """Return the horizontal part of a CRS: lidar DEMs often have a compound CRS, a site does not."""
    return crs.sub_crs_list[0] if crs.is_compound else crs


def name_of(crs: CRS) -> str:
    """Return `EPSG:...` if the CRS has such a code, else WKT."""
    authority = crs.to_authority()
    return ":".join(authority) if authority else str(crs.to_wkt())


@dataclass(frozen=True, eq=False)
class Dem:
    """An elevation raster with its geometry.

    `elevation`: (H, W) float32, metres, north up, NaN where unknown; values sit at cell centres and the surface is
    bilinear between them. Raises RasterError when shape and geometry disagree or no height is known.
    """

    elevation: Float32Array
    geometry: GridGeometry

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
    def levels(self) -> tuple[Dem, ...]:
        """Return the rasters that the terrain consists of, finest first: of a single one, itself (see `dem_stack`)."""
        return (self,)

    @classmethod
    def open(cls, path: Path | str, crs: str | None = None) -> Dem:
        """Read band 1 of any raster that GDAL reads, of any numeric dtype, scaled and with nodata as NaN.

        `crs`: the CRS of a raster that carries none; giving one that contradicts the file's is an error. Rows stored
        south-up are turned. Raises RasterError: not readable, no CRS or not in metres, rotated, or cells not square.
        """
        return cls(*read_heights(path, crs))

    def in_frame(self, frame: SiteFrame) -> Dem:
        """Return the same DEM in a site's map frame (CRS minus origin). Raises RasterError where the CRSs differ."""
        crs = self.geometry.crs
        if crs is None or CRS.from_user_input(crs) != horizontal(CRS.from_user_input(frame.crs)):
            raise RasterError(
                f"DEM is in {crs}, the site in {frame.crs}: warp it once with gdalwarp -r bilinear -t_srs {frame.crs}"
            )
        return Dem(self.elevation, self.geometry.translated(-frame.x_origin, -frame.y_origin))

    def elevation_at(self, x: ArrayLike, y: ArrayLike) -> Float64Array:
        """Return the bilinear height at map points, metres; NaN outside the outermost cell centres and beside
        nodata."""
        row, col = self.geometry.to_grid(x, y)
        height, width = self.elevation.shape
        inside = (row >= 0) & (row <= height - 1) & (col >= 0) & (col <= width - 1)
        r0 = np.clip(np.floor(np.where(inside, row, 0)), 0, height - 2).astype(np.int64)
        c0 = np.clip(np.floor(np.where(inside, col, 0)), 0, width - 2).astype(np.int64)
        fr, fc = row - r0, col - c0
        z = self.elevation
        north = (1 - fc) * z[r0, c0].astype(np.float64) + fc * z[r0, c0 + 1].astype(np.float64)
        south = (1 - fc) * z[r0 + 1, c0].astype(np.float64) + fc * z[r0 + 1, c0 + 1].astype(np.float64)
        return np.where(inside, (1 - fr) * north + fr * south, np.nan)

    def save(self, path: Path | str) -> None:
        """Write a deflated float32 GeoTIFF. Raises RasterError when the DEM is in no named CRS."""
        from ltm_core.raster.raster_io import write_geotiff

        write_geotiff(path, self.elevation, self.geometry, nodata=float("nan"))
