"""Fill the holes and blend the border of a fine raster, for `dem_stack`."""

import math

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float32Array, Float64Array


@helper()
def bilinear(nodes: Float32Array, row: float, col: float) -> float:
    """Return the height at a fractional row and column, that of the nearest cell outside the nodes."""
    i = min(max(math.floor(row), 0), nodes.shape[0] - 2)
    j = min(max(math.floor(col), 0), nodes.shape[1] - 2)
    v, u = row - i, col - j
    north = (1.0 - u) * nodes[i, j] + u * nodes[i, j + 1]
    south = (1.0 - u) * nodes[i + 1, j] + u * nodes[i + 1, j + 1]
    height: float = (1.0 - v) * north + v * south
    return height


@kernel()
def fill(fine: Float32Array, coarse: Float32Array, rows: Float64Array, cols: Float64Array) -> None:
    """Fill the holes of the fine raster row by row from the north; each column keeps the ends of its current hole."""
    height, width = fine.shape
    above, below = np.full(width, -1, np.int64), np.full(width, 0, np.int64)
    from_above, from_below = np.zeros(width), np.zeros(width)
    for i in range(height):
        j = 0
        while j < width:
            if fine[i, j] == fine[i, j]:
                j += 1
                continue
            end = j
            while end < width and fine[i, end] != fine[i, end]:
                end += 1
            west = _difference(fine, coarse, rows, cols, i, j - 1)
            east = _difference(fine, coarse, rows, cols, i, end)
            for k in range(j, end):
                if below[k] <= i:  # a hole begins in this column
                    above[k], below[k] = i - 1, i + 1
                    while below[k] < height and fine[below[k], k] != fine[below[k], k]:
                        below[k] += 1
                    from_above[k] = _difference(fine, coarse, rows, cols, above[k], k)
                    from_below[k] = _difference(fine, coarse, rows, cols, below[k], k)
                total, weight = 0.0, 0.0
                for difference, distance in (
                    (west, k - j + 1),
                    (east, end - k),
                    (from_above[k], i - above[k]),
                    (from_below[k], below[k] - i),
                ):
                    if difference == difference:
                        total += difference / distance
                        weight += 1.0 / distance
                if weight > 0.0:
                    fine[i, k] = bilinear(coarse, rows[i], cols[k]) + total / weight
            j = end


@helper()
def _difference(
    fine: Float32Array, coarse: Float32Array, rows: Float64Array, cols: Float64Array, i: int, j: int
) -> float:
    """Fine less coarse at a node; 0 outside the raster, NaN where the coarser level is not known."""
    if not (0 <= i < fine.shape[0] and 0 <= j < fine.shape[1]):
        return 0.0
    difference: float = fine[i, j] - bilinear(coarse, rows[i], cols[j])
    return difference


@kernel()
def blend(fine: Float32Array, coarse: Float32Array, rows: Float64Array, cols: Float64Array, band: float) -> None:
    height, width = fine.shape
    deep = math.ceil(band)
    for i in range(height):
        to_row_edge = min(i, height - 1 - i)
        j = 0
        while j < width:
            if to_row_edge >= band and j == deep:
                j = max(j, width - deep)
            distance = min(to_row_edge, j, width - 1 - j)
            if distance < band:
                there = bilinear(coarse, rows[i], cols[j])
                if there == there:
                    here = float(fine[i, j])
                    fine[i, j] = there if distance == 0 else here + (1.0 - distance / band) * (there - here)
            j += 1
