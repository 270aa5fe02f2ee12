"""Digital elevation model (DEM): an elevation raster in memory, opened from file and sampled bilinearly."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem_io import horizontal, read_heights


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
            raise RasterError("the DEM holds no height at all: every cell is nodata")
        object.__setattr__(self, "elevation", elevation)

    @property
    def levels(self) -> tuple[Dem, ...]:
        """The rasters that the terrain consists of, finest first: of a single one, itself (see `dem_stack`)."""
        return (self,)

    @classmethod
    def open(cls, path: Path | str, crs: str | None = None) -> Dem:
        """Read band 1 of any raster that GDAL reads, of any numeric dtype, scaled and with nodata as NaN.

        `crs`: the CRS of a raster that carries none; giving one that contradicts the file's is an error. Rows stored
        south-up are turned. Raises RasterError: not readable, no CRS or not in metres, rotated, or cells not square.
        """
        return cls(*read_heights(path, crs))

    def in_frame(self, frame: SiteFrame) -> Dem:
        """The same DEM in a site's map frame (CRS minus origin). Raises RasterError where the CRSs differ."""
        crs = self.geometry.crs
        if crs is None or CRS.from_user_input(crs) != horizontal(CRS.from_user_input(frame.crs)):
            raise RasterError(
                f"DEM is in {crs}, the site in {frame.crs}: warp it once with gdalwarp -r bilinear -t_srs {frame.crs}"
            )
        return Dem(self.elevation, self.geometry.translated(-frame.x_origin, -frame.y_origin))

    def elevation_at(self, x: ArrayLike, y: ArrayLike) -> Float64Array:
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
        from ltm_core.raster.raster_io import write_geotiff

        write_geotiff(path, self.elevation, self.geometry, nodata=float("nan"))
