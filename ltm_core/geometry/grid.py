"""Raster geometry: the only code that converts between row/column and x/y."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import RasterError
from ltm_core.base.types import BoolArray, Float64Array, Int64Array


@dataclass(frozen=True)
class GridGeometry:
    """A north-up raster of square cells; row 0 is the northernmost.

    `x_min`, `y_max`: outer edges of the raster (not cell centres), metres in `crs` or, where `crs` is None, in the
    site's map frame. `resolution`: cell size, metres. Raises RasterError on values that make no raster."""

    x_min: float
    y_max: float
    resolution: float
    width: int
    height: int
    crs: str | None = None

    def __post_init__(self) -> None:
        if not all(math.isfinite(v) for v in (self.x_min, self.y_max, self.resolution)) or self.resolution <= 0:
            raise RasterError(
                f"raster geometry needs finite edges and a positive resolution, got x_min={self.x_min}, "
                f"y_max={self.y_max}, resolution={self.resolution}"
            )
        if self.width < 1 or self.height < 1:
            raise RasterError(f"raster needs at least one cell, got {self.width} x {self.height}")

    @property
    def shape(self) -> tuple[int, int]:
        return self.height, self.width

    @property
    def x_max(self) -> float:
        return self.x_min + self.width * self.resolution

    @property
    def y_min(self) -> float:
        return self.y_max - self.height * self.resolution

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Return (x_min, y_min, x_max, y_max)."""
        return self.x_min, self.y_min, self.x_max, self.y_max

    def described(self) -> str:
        """Return its bounds, in whole metres, for messages."""
        return f"x {self.x_min:.0f} to {self.x_max:.0f}, y {self.y_min:.0f} to {self.y_max:.0f}"

    def distance_to(self, x: float, y: float) -> float:
        """Return the metres from a point to the raster's edge; 0 within."""
        return math.hypot(max(self.x_min - x, x - self.x_max, 0.0), max(self.y_min - y, y - self.y_max, 0.0))

    def to_grid(self, x: ArrayLike, y: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Convert map coordinates to fractional (row, col); integers fall on cell centres."""
        col = (np.asarray(x, np.float64) - self.x_min) / self.resolution - 0.5
        row = (self.y_max - np.asarray(y, np.float64)) / self.resolution - 0.5
        return row, col

    def to_map(self, row: ArrayLike, col: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Convert fractional (row, col) to map coordinates (x, y)."""
        x = self.x_min + (np.asarray(col, np.float64) + 0.5) * self.resolution
        y = self.y_max - (np.asarray(row, np.float64) + 0.5) * self.resolution
        return x, y

    def cell_of(self, x: ArrayLike, y: ArrayLike) -> tuple[Int64Array, Int64Array]:
        """Return the (row, col) of the cell that holds each point; may lie outside the raster (see `contains`).

        Cells partition the plane: a point on a shared edge belongs to the cell to its east or south."""
        col = np.floor((np.asarray(x, np.float64) - self.x_min) / self.resolution).astype(np.int64)
        row = np.floor((self.y_max - np.asarray(y, np.float64)) / self.resolution).astype(np.int64)
        return row, col

    def contains(self, row: ArrayLike, col: ArrayLike) -> BoolArray:
        """Return which cell indices lie inside the raster."""
        row, col = np.asarray(row), np.asarray(col)
        inside: BoolArray = (row >= 0) & (row < self.height) & (col >= 0) & (col < self.width)
        return inside

    def translated(self, dx: float, dy: float, crs: str | None = None) -> "GridGeometry":
        """Return the same raster with its edges moved by (dx, dy) metres; `crs` names the frame that it is then in."""
        return GridGeometry(self.x_min + dx, self.y_max + dy, self.resolution, self.width, self.height, crs=crs)

    def window(self, row: int, col: int, height: int, width: int) -> "GridGeometry":
        """Return the part of the raster whose first cell is (row, col)."""
        corner = self.x_min + col * self.resolution, self.y_max - row * self.resolution
        return GridGeometry(*corner, self.resolution, width, height, self.crs)

    @classmethod
    def snapped(
        cls, bounds: tuple[float, float, float, float], resolution: float, phase: float = 15.0, crs: str | None = None
    ) -> "GridGeometry":
        """Return the smallest raster over `bounds` (x_min, y_min, x_max, y_max) whose cell edges lie at phase mod
        resolution.

        LANDFIRE's grid has resolution 30 and phase 15 in EPSG:5070."""
        west, south = (math.floor((v - phase) / resolution) for v in bounds[:2])
        east, north = (math.ceil((v - phase) / resolution) for v in bounds[2:])
        corner = west * resolution + phase, north * resolution + phase
        return cls(*corner, resolution, max(1, east - west), max(1, north - south), crs)

    def transform(self) -> Any:
        """Return the affine transform (pixel corner -> map) that rasterio writes."""
        from rasterio.transform import from_origin

        return from_origin(self.x_min, self.y_max, self.resolution, self.resolution)
