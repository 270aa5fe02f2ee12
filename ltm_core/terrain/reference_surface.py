"""The reference surface: bare earth and what stands on it, as assumed until views agree on a change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.dem import Dem
from ltm_core.errors import ConfigError
from ltm_core.grid import GridGeometry
from ltm_core.types import Float32Array, Float64Array

BLOCK = 8
"""Cells a side over which the slope of the surface is taken: crowns and boulders have slopes, but no incidence."""
LARGEST = 50_000_000
"""Cells of a site: heights, slopes and the tracer's pyramid of more would not leave a tower computer room."""
_ROWS = 256


class Elevations(Protocol):
    """What heights can be asked of: a `Dem` or a stack of them."""

    @property
    def geometry(self) -> GridGeometry: ...

    def elevation_at(self, x: ArrayLike, y: ArrayLike) -> Float64Array: ...


class Slopes(NamedTuple):
    """Rise per metre to the east and to the north of blocks of BLOCK x BLOCK cells, (h, w) each; 0 where unknown."""

    east: Float32Array
    north: Float32Array


@dataclass(frozen=True, eq=False)
class Reference:
    """Two hypotheses on one grid, in the map frame.

    `bare`: bare earth, (H, W) metres, never changed. `surface`: with canopy and buildings; the same array where no
    surface raster is known (`canopy_known` False): then the first consistent observations of a cell become its
    canopy, and only what contradicts those, or lies below bare earth, is change.
    """

    bare: Float32Array
    surface: Float32Array
    geometry: GridGeometry
    slopes: Slopes

    @property
    def canopy_known(self) -> bool:
        return self.surface is not self.bare

    @property
    def surface_dem(self) -> Dem:
        """The surface (with what stands on the ground) as a DEM for the tracer."""
        return Dem(self.surface, self.geometry)

    @classmethod
    def of(cls, bare: Elevations, surface: Elevations | None = None, resolution: float | None = None) -> Reference:
        """Both hypotheses at the cell centres of a grid over `bare` with cells of `resolution` (default: its own).

        Where the surface raster is unknown or below bare earth, bare earth stands. Raises ConfigError where the grid
        has too many cells.
        """
        whole = bare.geometry
        cell = resolution or whole.resolution
        height = max(2, round(whole.height * whole.resolution / cell))
        width = max(2, round(whole.width * whole.resolution / cell))
        if height * width > LARGEST:
            side = (whole.height * whole.width * whole.resolution**2 / LARGEST) ** 0.5
            raise ConfigError(
                f"a terrain of {width} x {height} cells of {cell} m is too large (at most {LARGEST:,} cells): set "
                f"terrain.resolution to {side:.1f} m or more"
            )
        geometry = GridGeometry(whole.x_min, whole.y_max, cell, width, height, whole.crs)
        ground = _sampled(bare, geometry)
        top = ground
        if surface is not None:
            above = _sampled(surface, geometry)
            top = np.empty_like(ground)
            for row in range(0, height, _ROWS):
                part = slice(row, row + _ROWS)
                np.fmax(above[part], ground[part], out=top[part])
        return cls(ground, top, geometry, _slopes(top, cell))


def _sampled(source: Elevations, geometry: GridGeometry) -> Float32Array:
    elevation = getattr(source, "elevation", None)
    if isinstance(elevation, np.ndarray) and source.geometry == geometry:
        return np.asarray(elevation, np.float32)
    heights = np.empty(geometry.shape, np.float32)
    cols = np.arange(geometry.width)
    for row in range(0, geometry.height, _ROWS):
        rows = np.arange(row, min(row + _ROWS, geometry.height))
        x, y = geometry.to_map(rows[:, None], cols[None, :])
        x, y = np.broadcast_arrays(x, y)
        # The outermost half cell has no bilinear height: it takes that of the outermost cell centres.
        inner = source.geometry
        half = inner.resolution / 2 + 1e-6
        heights[rows] = source.elevation_at(
            np.clip(x, inner.x_min + half, inner.x_max - half), np.clip(y, inner.y_min + half, inner.y_max - half)
        )
    return heights


def _slopes(surface: Float32Array, resolution: float) -> Slopes:
    """Differences between the means of neighbouring blocks."""
    height, width = (max(1, -(-n // BLOCK)) for n in surface.shape)
    means = np.full((height, width), np.nan, np.float32)
    for row in range(height):
        strip = surface[row * BLOCK : (row + 1) * BLOCK]
        known = np.isfinite(strip)
        edges = np.arange(0, surface.shape[1], BLOCK)
        sums = np.add.reduceat(np.where(known, strip, 0).sum(axis=0, dtype=np.float64), edges)
        counts = np.add.reduceat(known.sum(axis=0), edges)
        means[row] = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    step = BLOCK * resolution
    east, north = np.zeros_like(means), np.zeros_like(means)
    if width > 1:
        east = np.gradient(means, step, axis=1).astype(np.float32)
    if height > 1:
        north = -np.gradient(means, step, axis=0).astype(np.float32)
    return Slopes(np.nan_to_num(east), np.nan_to_num(north))
