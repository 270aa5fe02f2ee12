"""Canopy of fuel cells whose surface has changed: its cover and height, from the confirmed surface over bare earth.

Where nothing was confirmed the prior's canopy stands. A site without a raster of tree tops has no heights of trees, and
so none of this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.confirmed_terrain import ConfirmedTerrain
from ltm_core.dem import Dem
from ltm_core.grid import GridGeometry
from ltm_core.terrain.fuel_change import LEAST_SHARE
from ltm_core.types import Float32Array, IndexArray, Int16Array

TALL = 2.0
"""Metres above ground from which on plants are canopy: the height break of airborne surveys of tree cover."""
_ALIKE = 5.0
"""Metres within which heights of a stand err and vary together, as the surface map smooths them."""
_MOST_SAMPLES = 30
"""Of the surface, a side of a fuel cell."""
_CELLS = 1000
"""Fuel cells that are worked on at a time."""


@dataclass(frozen=True, eq=False)
class SeenCanopy:
    """(H, W) each, NaN where no change was confirmed. `cover`: %; `height`: mean of the canopy's top over bare earth,
    metres, 0 where no canopy is left; and the standard errors of both.
    """

    cover: Float32Array
    height: Float32Array
    cover_sigma: Float32Array
    height_sigma: Float32Array


def seen_canopy(terrain: ConfirmedTerrain, grid: GridGeometry) -> SeenCanopy | None:
    """Of the cells of a fuel grid (in the map frame) a quarter of which has changed; None where nothing is confirmed,
    or it is not known what stood on the ground before.
    """
    if terrain.surface is None or not terrain.canopy_known:
        return None
    cells = terrain.surface
    row, col = grid.cell_of(*cells.geometry.to_map(cells.rows, cells.cols))
    inside = grid.contains(row, col)
    counts = np.bincount(row[inside] * grid.width + col[inside], minlength=grid.width * grid.height)
    ratio = grid.resolution / cells.geometry.resolution
    chosen = np.flatnonzero(counts >= LEAST_SHARE * ratio**2)
    found = np.full((4, grid.height * grid.width), np.nan, np.float32)
    side = int(np.clip(round(ratio), 1, _MOST_SAMPLES))
    for start in range(0, len(chosen), _CELLS):
        part = chosen[start : start + _CELLS]
        found[:, part] = _measured(terrain.top, terrain.ground, grid, part, side)
    return SeenCanopy(*found.reshape(4, *grid.shape))


def with_seen_canopy(bands: Int16Array, seen: SeenCanopy) -> Int16Array:
    """Canopy bands (4, H, W) of cells with trees as they are seen now: cover and height as measured; the base of the
    crowns keeps its share of the height, and bulk density, the mass of the stand by its volume, its share of the cover.

    The shares are the prior's, or the region's where that has none. Cells without trees stay.
    """
    cover, height, base, density = (band.astype(np.float64) for band in bands)
    now = np.isfinite(seen.cover) & (cover > 0) & (height > 0)
    tops, share = 10.0 * np.nan_to_num(seen.height), np.nan_to_num(seen.cover)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.stack([share, tops, base * tops / height, density * share / cover])
    return np.where(now, np.round(moved), bands).astype(np.int16)


def _measured(top: Dem, ground: Dem, grid: GridGeometry, cells: IndexArray, side: int) -> Float32Array:
    """Cover, height and their standard errors (4, N) of cells by their flat places, from side x side points each."""
    rows, cols = np.divmod(cells, grid.width)
    offsets = (np.arange(side) + 0.5) / side - 0.5
    x, y = grid.to_map(rows[:, None, None] + offsets[:, None], cols[:, None, None] + offsets)
    x, y = (points.reshape(len(cells), -1) for points in np.broadcast_arrays(x, y))
    above = top.elevation_at(x, y) - ground.elevation_at(x, y)
    known = np.isfinite(above)
    canopy = known & (above >= TALL)
    stands, points = canopy.sum(axis=1), np.maximum(known.sum(axis=1), 1)
    share = stands / points
    height = np.where(canopy, above, 0.0).sum(axis=1) / np.maximum(stands, 1)
    spread = np.sqrt((np.where(canopy, above - height[:, None], 0.0) ** 2).sum(axis=1) / np.maximum(stands, 1))
    independent = (grid.resolution / _ALIKE) ** 2
    errors = 100 * np.sqrt(share * (1 - share) / independent), spread / np.sqrt(np.maximum(independent * share, 1))
    found = np.stack([100 * share, height, *errors])
    return np.where(known.any(axis=1), found, np.nan).astype(np.float32)
