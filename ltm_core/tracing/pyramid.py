"""Maximum pyramid of a DEM: for each block of cells, a height that no ground in the block exceeds.

Level L holds blocks of 2^L x 2^L cells; a block is *closed*: its bound covers all (2^L + 1)^2 nodes, those it shares
with its neighbours too, so the bilinear surface over the block never rises above it. The lowest level that is stored
is LEAF; from there tracers go straight to single cells (level 0) and read the nodes. All levels lie in one flat array,
which adds a twelfth to the memory of the elevations.

A bound is the highest node (or ceiling of an enclosed hole), +inf where the block holds some outer hole and must be
opened, or NaN where all its cells are outer holes, so that it can be crossed in one step (see `holes`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ltm_core.tracing.holes import Holes, filled_at
from ltm_core.types import Float32Array, Int64Array

LEAF = 2
"""The lowest level stored: level 1 alone would cost a quarter of the elevations' memory, and saves little time."""


class MaximumPyramid(NamedTuple):
    """Bounds of all levels in one flat array.

    Level L (LEAF <= L <= `top_level`) is row-major at `bounds[offsets[L]:]`, `widths[L]` blocks a row; lower indices
    of both are unused.
    """

    bounds: Float32Array
    offsets: Int64Array
    widths: Int64Array

    @property
    def top_level(self) -> int:
        """The level at which one block covers the raster."""
        return len(self.offsets) - 1


def build_pyramid(nodes: Float32Array, holes: Holes) -> MaximumPyramid:
    """Pyramid over the cells between (H, W) nodes, NaN in holes (see `holes.find_holes`); H and W at least 2."""
    heights, widths, offsets = [nodes.shape[0] - 1], [nodes.shape[1] - 1], [0]
    total = 0
    while len(heights) <= LEAF or heights[-1] > 1 or widths[-1] > 1:
        heights.append((heights[-1] + 1) // 2)
        widths.append((widths[-1] + 1) // 2)
        offsets.append(total)
        if len(heights) > LEAF:
            total += heights[-1] * widths[-1]
    bounds = np.empty(total, dtype=np.float32)
    _bounds_from_nodes(nodes, holes, bounds[: heights[LEAF] * widths[LEAF]].reshape(heights[LEAF], widths[LEAF]))
    for level in range(LEAF + 1, len(heights)):
        below = bounds[offsets[level - 1] : offsets[level]].reshape(heights[level - 1], widths[level - 1])
        here = bounds[offsets[level] : offsets[level] + heights[level] * widths[level]]
        _bounds_from_bounds(below, here.reshape(heights[level], widths[level]))
    return MaximumPyramid(bounds, np.array(offsets, dtype=np.int64), np.array(widths, dtype=np.int64))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _bounds_from_nodes(nodes: Float32Array, holes: Holes, bounds: Float32Array) -> None:
    """Level LEAF: the bound of a block of cells from its nodes."""
    n_rows, n_cols = nodes.shape
    flat = nodes.ravel()
    size = 1 << LEAF
    for i in range(bounds.shape[0]):
        row0, row_end = size * i, min(size * (i + 1), n_rows - 1)
        for j in range(bounds.shape[1]):
            col0, col_end = size * j, min(size * (j + 1), n_cols - 1)
            highest = np.float32(-np.inf)
            any_outer = False
            for row in range(row0, row_end + 1):
                for col in range(col0, col_end + 1):
                    node = nodes[row, col]
                    if node > highest:
                        highest = node
                    elif node != node:
                        ceiling = filled_at(flat, holes, row * n_cols + col)
                        highest = max(highest, ceiling) if ceiling == ceiling else highest
                        any_outer = any_outer or ceiling != ceiling
            if any_outer:
                all_outer = _all_cells_outer(nodes, holes, row0, row_end, col0, col_end)
                highest = np.float32(np.nan) if all_outer else np.float32(np.inf)
            bounds[i, j] = highest


@njit(cache=True)  # type: ignore[untyped-decorator]
def _all_cells_outer(nodes: Float32Array, holes: Holes, row0: int, row_end: int, col0: int, col_end: int) -> bool:
    width, flat = nodes.shape[1], nodes.ravel()
    for row in range(row0, row_end):
        for col in range(col0, col_end):
            at = row * width + col
            north = filled_at(flat, holes, at) + filled_at(flat, holes, at + 1)
            south = filled_at(flat, holes, at + width) + filled_at(flat, holes, at + width + 1)
            if not np.isnan(north + south):
                return False
    return True


@njit(cache=True)  # type: ignore[untyped-decorator]
def _bounds_from_bounds(below: Float32Array, bounds: Float32Array) -> None:
    """A level from the one below: the maximum of up to 2 x 2 blocks."""
    for i in range(bounds.shape[0]):
        row_end = min(2 * i + 2, below.shape[0])
        for j in range(bounds.shape[1]):
            col_end = min(2 * j + 2, below.shape[1])
            highest = np.float32(-np.inf)
            outer = 0
            for row in range(2 * i, row_end):
                for col in range(2 * j, col_end):
                    bound = below[row, col]
                    if bound > highest:
                        highest = bound
                    elif bound != bound:
                        outer += 1
            if outer > 0:
                every = (row_end - 2 * i) * (col_end - 2 * j)
                highest = np.float32(np.nan) if outer == every else np.float32(np.inf)
            bounds[i, j] = highest
