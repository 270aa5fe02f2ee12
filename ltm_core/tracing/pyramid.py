"""Maximum pyramid of a DEM: for each block of cells, a height that no ground in the block exceeds.

Level L holds blocks of 2^L x 2^L cells; a block is *closed*: its bound covers all (2^L + 1)^2 nodes, those it shares
with its neighbours too, so the bilinear surface over the block never rises above it. The lowest level that is stored
is LEAF; from there tracers go straight to single cells (level 0) and read the nodes. All levels lie in one flat array,
which adds a twelfth to the memory of the elevations.

A bound is the highest node, or ceiling of a node in a hole (see `holes`). Where the raster has outer holes, it is known
besides of each block whether its cells belong to them: a camera outside the DEM sees through those."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.kernels import kernel
from ltm_core.base.types import Float32Array, Int64Array, UInt8Array
from ltm_core.tracing.holes import Holes, filled_at, in_outer_hole

LEAF = 2
"""Lowest level stored; level 1 alone would need a quarter of the elevations' memory and saves little time."""

WITHIN, MIXED, OUTSIDE = 0, 1, 2
"""State of a block: none, some or all of its cells are outer holes."""


class MaximumPyramid(NamedTuple):
    """Bounds of all levels in one flat array: level L from LEAF on is row-major at `bounds[offsets[L]:]`,
    `widths[L]` blocks a row; lower indices of both are unused."""

    bounds: Float32Array
    offsets: Int64Array
    widths: Int64Array
    outside: UInt8Array
    """WITHIN, MIXED or OUTSIDE, in the order of `bounds`; empty if the raster has no outer hole."""


def build_pyramid(nodes: Float32Array, holes: Holes) -> MaximumPyramid:
    """Return the pyramid over the cells between (H, W) nodes, NaN in holes (see `holes.find_holes`); H and W at least
    2."""
    heights, widths, offsets = [nodes.shape[0] - 1], [nodes.shape[1] - 1], [0]
    total = 0
    while len(heights) <= LEAF or heights[-1] > 1 or widths[-1] > 1:
        heights.append((heights[-1] + 1) // 2)
        widths.append((widths[-1] + 1) // 2)
        offsets.append(total)
        if len(heights) > LEAF:
            total += heights[-1] * widths[-1]
    bounds = np.empty(total, dtype=np.float32)
    outside = np.empty(total if holes.hole_outer.any() else 0, dtype=np.uint8)

    def blocks(of: NDArray[Any], level: int) -> NDArray[Any]:
        return of[offsets[level] :][: heights[level] * widths[level]].reshape(heights[level], widths[level])

    flat, columns = nodes.ravel(), nodes.shape[1]
    _bounds_from_nodes(flat, columns, holes, blocks(bounds, LEAF))
    if outside.size:
        _outside_from_nodes(flat, columns, holes, blocks(outside, LEAF))
    for level in range(LEAF + 1, len(heights)):
        blocks(bounds, level)[:] = _of_four(np.maximum, blocks(bounds, level - 1))
        if outside.size:
            most, least = (_of_four(reduce, blocks(outside, level - 1)) for reduce in (np.maximum, np.minimum))
            blocks(outside, level)[:] = np.where(most == least, most, MIXED)
    return MaximumPyramid(bounds, np.array(offsets, dtype=np.int64), np.array(widths, dtype=np.int64), outside)


@kernel()
def _bounds_from_nodes(flat: Float32Array, n_cols: int, holes: Holes, bounds: Float32Array) -> None:
    """Compute the level LEAF: the bound of a block of cells from its nodes."""
    n_rows, size = len(flat) // n_cols, 1 << LEAF
    for i in range(bounds.shape[0]):
        row0, row_end = size * i, min(size * (i + 1), n_rows - 1)
        for j in range(bounds.shape[1]):
            col0, col_end = size * j, min(size * (j + 1), n_cols - 1)
            highest = np.float32(-np.inf)
            for row in range(row0, row_end + 1):
                for col in range(col0, col_end + 1):
                    node = flat[row * n_cols + col]
                    if node > highest:
                        highest = node
                    elif node != node:
                        highest = max(highest, filled_at(flat, holes, row * n_cols + col))
            bounds[i, j] = highest


@kernel()
def _outside_from_nodes(flat: Float32Array, n_cols: int, holes: Holes, outside: UInt8Array) -> None:
    """Compute the level LEAF: a cell is an outer hole where one of its nodes belongs to one."""
    n_rows, size = len(flat) // n_cols, 1 << LEAF
    for i in range(outside.shape[0]):
        row0, row_end = size * i, min(size * (i + 1), n_rows - 1)
        for j in range(outside.shape[1]):
            col0, col_end = size * j, min(size * (j + 1), n_cols - 1)
            count = 0
            for row in range(row0, row_end):
                for col in range(col0, col_end):
                    at = row * n_cols + col
                    count += (
                        in_outer_hole(flat, holes, at)
                        or in_outer_hole(flat, holes, at + 1)
                        or in_outer_hole(flat, holes, at + n_cols)
                        or in_outer_hole(flat, holes, at + n_cols + 1)
                    )
            every = (row_end - row0) * (col_end - col0)
            outside[i, j] = WITHIN if count == 0 else OUTSIDE if count == every else MIXED


def _of_four(reduce: np.ufunc, below: NDArray[Any]) -> NDArray[Any]:
    """Return what `reduce` makes of each of up to 2 x 2 blocks."""
    rows = reduce.reduceat(below, np.arange(0, below.shape[0], 2), axis=0)
    return np.asarray(reduce.reduceat(rows, np.arange(0, below.shape[1], 2), axis=1))
