"""Digital elevation models: opening, sampling, nodata."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from ltm_core.errors import RasterError
from ltm_core.geodesy import SiteFrame
from ltm_core.grid import GridGeometry


@dataclass(frozen=True, eq=False)
class Dem:
    """An elevation raster with its geometry.

    `elevation`: (H, W) float32, metres, north up, NaN where unknown; values sit at cell centres and the surface is
    bilinear between them. Raises RasterError when shape and geometry disagree or no height is known.
    """

    elevation: NDArray[np.float32]
    geometry: GridGeometry

    def __post_init__(self) -> None:
        elevation = np.ascontiguousarray(self.elevation, np.float32)
        if elevation.shape != self.geometry.shape:
            raise RasterError(f"elevation of shape {elevation.shape} does not fit a raster of {self.geometry.shape}")
        if min(elevation.shape) < 2:
            raise RasterError(f"a DEM needs at least 2 x 2 heights to span a surface, got {elevation.shape}")
        if not np.isfinite(elevation).any():
            raise RasterError("the DEM holds no height at all: every cell is nodata")
        object.__setattr__(self, "elevation", elevation)

    @classmethod
    def open(cls, path: Path | str, crs: str | None = None) -> Dem:
        """Read band 1 of any raster that GDAL reads, of any numeric dtype, scaled and with nodata as NaN.

        `crs`: the CRS of a raster that carries none; giving one that contradicts the file's is an error. Rows stored
        south-up are turned. Raises RasterError: not readable, no CRS or not in metres, rotated, or cells not square.
        """
        import rasterio
        from rasterio.errors import RasterioError

        try:
            with rasterio.open(path) as source:
                stated = _crs_of(source.crs, crs, path)
                if np.issubdtype(np.dtype(source.dtypes[0]), np.complexfloating):
                    raise RasterError(f"{path}: band 1 is {source.dtypes[0]}; elevation must be a real number")
                if re.search(r"f(oo|ee)?t\b", source.units[0] or "", re.IGNORECASE):
                    raise RasterError(f"{path}: heights are in {source.units[0]}; convert them to metres first")
                t = source.transform
                if t.b or t.d:
                    raise RasterError(f"{path}: rotated raster {tuple(t)[:6]}; warp it north-up first (gdalwarp)")
                if not np.isclose(abs(t.a), abs(t.e), rtol=1e-6) or t.a <= 0:
                    raise RasterError(
                        f"{path}: cells must be square, got {t.a} x {t.e} m; warp it first (gdalwarp -tr)"
                    )
                band = source.read(1, masked=True)
                scale, offset = source.scales[0], source.offsets[0]
        except RasterioError as error:
            raise RasterError(f"{path}: not a raster that GDAL can read ({error})") from error
        elevation = band.filled(np.nan) if band.dtype.kind == "f" else band.astype(np.float32).filled(np.nan)
        elevation = np.where(np.isfinite(elevation), elevation, np.nan)
        if (scale, offset) != (1.0, 0.0):
            elevation = elevation * scale + offset
        height, width = elevation.shape
        if t.e > 0:
            elevation = elevation[::-1]
        y_max = t.f if t.e < 0 else t.f + height * t.e
        return cls(elevation.astype(np.float32), GridGeometry(t.c, y_max, t.a, width, height, stated))

    def in_frame(self, frame: SiteFrame) -> Dem:
        """The same DEM in a site's map frame (CRS minus origin). Raises RasterError where the CRSs differ."""
        crs = self.geometry.crs
        if crs is None or CRS.from_user_input(crs) != _horizontal(CRS.from_user_input(frame.crs)):
            raise RasterError(
                f"DEM is in {crs}, the site in {frame.crs}: warp it once with gdalwarp -r bilinear -t_srs {frame.crs}"
            )
        return Dem(self.elevation, self.geometry.translated(-frame.x_origin, -frame.y_origin))

    def elevation_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Bilinear height at map points, metres; NaN outside the outermost cell centres and beside nodata."""
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
        from ltm_core.raster_io import write_geotiff

        write_geotiff(path, self.elevation, self.geometry, nodata=float("nan"))


def _crs_of(stated: object, given: str | None, path: Path | str) -> str:
    """The horizontal CRS: what a site is compared with; a stated height system is only checked to be in metres."""
    from pyproj.exceptions import CRSError

    try:
        named = None if given is None else CRS.from_user_input(given)
    except CRSError as error:
        raise RasterError(f"{path}: unknown CRS {given!r}: give an EPSG code such as EPSG:32611 ({error})") from error
    crs = named if stated is None else CRS.from_user_input(stated)
    if crs is None:
        raise RasterError(f"{path}: the raster carries no CRS; name it with --crs or `dem: {{crs: EPSG:...}}`")
    for axis in crs.axis_info[2:]:
        if axis.unit_name != "metre":
            raise RasterError(f"{path}: heights of {crs.name} are in {axis.unit_name}; convert them to metres first")
    crs = _horizontal(crs)
    if named is not None and _horizontal(named) != crs:
        raise RasterError(f"{path}: the raster is in {crs.name}, but {given} was given")
    if not crs.is_projected or {axis.unit_name for axis in crs.axis_info[:2]} != {"metre"}:
        raise RasterError(f"{path}: a DEM must be projected in metres, {crs.name} is not; warp it first (gdalwarp)")
    authority = crs.to_authority()
    return ":".join(authority) if authority else str(crs.to_wkt())


def _horizontal(crs: CRS) -> CRS:
    """Lidar DEMs often name their height system too (a compound CRS), which a site's CRS does not."""
    return crs.sub_crs_list[0] if crs.is_compound else crs
