"""Compiled access to the reference surface: heights, cells, slopes, and the height variance due to pose errors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ltm_core.terrain.cell_layout import CELLS, PLACE_BITS, TILE, TILE_BITS
from ltm_core.types import Float32Array, Float64Array

LEAST_INCIDENCE = 0.1
"""Of the incidence factor: a grazing ray's height does not depend on its range, but it is not exact either."""


class ReferenceGrid(NamedTuple):
    """`surface`, `bare`: (H, W) metres, with what stands on the ground and without; `east`, `north`: rise per metre of
    blocks of `block` cells a side, `highest`: of what is known of each and the cells around it, -inf where nothing is;
    `across`: tiles.
    """

    surface: Float32Array
    bare: Float32Array
    east: Float32Array
    north: Float32Array
    highest: Float32Array
    block: int
    x_min: float
    y_max: float
    resolution: float
    across: int


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def height_at(ground: ReferenceGrid, x: float, y: float) -> float:
    """Bilinear; NaN outside the outermost cell centres."""
    col = (x - ground.x_min) / ground.resolution - 0.5
    row = (ground.y_max - y) / ground.resolution - 0.5
    height, width = ground.surface.shape
    if not (row >= 0.0 and col >= 0.0 and row <= height - 1.0 and col <= width - 1.0):
        return math.nan
    r = min(int(row), height - 2)
    c = min(int(col), width - 2)
    fr, fc = row - r, col - c
    z = ground.surface
    north = z[r, c] + fc * (z[r, c + 1] - z[r, c])
    south = z[r + 1, c] + fc * (z[r + 1, c + 1] - z[r + 1, c])
    height_here: float = north + fr * (south - north)
    return height_here


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def cell_at(ground: ReferenceGrid, x: float, y: float) -> tuple[int, int]:
    """Row and column; -1, -1 outside."""
    col = math.floor((x - ground.x_min) / ground.resolution)
    row = math.floor((ground.y_max - y) / ground.resolution)
    height, width = ground.surface.shape
    if not (row >= 0 and col >= 0 and row < height and col < width):
        return -1, -1
    return int(row), int(col)


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def stood_at(ground: ReferenceGrid, place: int) -> float:
    """Metres of what stands in a cell."""
    tile, k = place >> PLACE_BITS, place & (CELLS - 1)
    row = ((tile // ground.across) << TILE_BITS) + (k >> TILE_BITS)
    col = ((tile % ground.across) << TILE_BITS) + (k & (TILE - 1))
    height: float = ground.surface[row, col] - ground.bare[row, col]
    return height


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def slopes_at(ground: ReferenceGrid, row: int, col: int) -> tuple[float, float]:
    r, c = row // ground.block, col // ground.block
    return np.float64(ground.east[r, c]), np.float64(ground.north[r, c])


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def steepness(ground: ReferenceGrid, r: int, c: int, dx: float, dy: float, dz: float) -> float:
    """The incidence factor on the cell's own slope; 0 where that is not known."""
    height, width = ground.surface.shape
    z, step = ground.surface, 2 * ground.resolution
    east = (z[r, min(c + 1, width - 1)] - z[r, max(c - 1, 0)]) / step
    north = (z[max(r - 1, 0), c] - z[min(r + 1, height - 1), c]) / step
    steep: float = abs(dz - east * dx - north * dy)
    return steep if steep < math.inf else 0.0


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def pose_variance(covariance: Float64Array, east: float, north: float, px: float, py: float, pz: float) -> float:
    """Variance of the height of a surface with these slopes, seen at (px, py, pz) from the camera: the row of the
    camera's shift o and turn w in n.(o + w x p) / n_z is [n, p x n] / n_z, with n / n_z = (-east, -north, 1).
    """
    nx, ny = -east, -north
    row = (nx, ny, 1.0, py - pz * ny, pz * nx - px, px * ny - py * nx)
    total = 0.0
    for i in range(6):
        part = 0.0
        for j in range(6):
            part += covariance[i, j] * row[j]
        total += row[i] * part
    return max(total, 0.0)
