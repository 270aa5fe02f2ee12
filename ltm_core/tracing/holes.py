"""Bound the ground height where a DEM has no data: in its holes, over its edge and beyond it.

A *node* is a DEM cell centre; a *cell* of the tracer is the square between four nodes. The *ceiling* of a NaN node is
the highest that its ground may be: no higher than any known node beside the hole plus `steepest` times the way to it
within the hole; and besides

* in an **enclosed** hole, which known ground surrounds, no higher than the highest known node that touches it;
* in an **outer** hole, which reaches the edge of the raster and is outside the DEM as the space beyond it is, no higher
  than `highest`.

Holes are held as runs of NaN nodes along rows with their ceilings; a filled raster would double a DEM's memory."""

from typing import NamedTuple

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int64Array

_DIAGONAL = float(np.sqrt(2.0))
_ROWS = 256
"""Number of rows searched at a time; masks of a whole raster would take as much memory as its heights."""


class Holes(NamedTuple):
    """Runs of NaN nodes in the order of their flat indices, and the ceilings of these nodes."""

    hole_first: Int64Array
    """Flat index (row * width + column) of a run's first node."""
    hole_outer: BoolArray
    """Whether a run belongs to an outer hole."""
    hole_start: Int64Array
    """Start of a run's ceilings in `ceilings`."""
    ceilings: Float32Array
    """Ceilings of all NaN nodes, run after run."""


def find_holes(elevation: Float32Array, rise: float, highest: float) -> Holes:
    """Return the holes of (H, W) float32 elevations, NaN if nodata; at least one is known. `rise`: maximum rise of
    unknown ground between nodes, metres; `highest`: its maximum height in outer holes."""
    width = elevation.shape[1]
    row, first, end = _runs(elevation)
    if not row.size:  # most often: no kernel is loaded
        return Holes(row, np.empty(0, np.bool_), row, np.empty(0, np.float32))
    rim = _rims(elevation, row, first, end, _joined(row, first, end, width))
    start = np.concatenate([[0], np.cumsum(end - first)])[:-1].astype(np.int64)
    ceilings = np.full(int((end - first).sum()), np.inf, np.float32)
    steps = np.float32(rise), np.float32(rise * _DIAGONAL)
    while _lowered(elevation, row, first, end, start, ceilings, *steps):
        pass
    outer = np.isinf(rim)
    np.minimum(ceilings, np.repeat(np.where(outer, highest, rim).astype(np.float32), end - first), out=ceilings)
    return Holes(row * width + first, outer, start, ceilings)


@helper()
def run_of(holes: Holes, at: int) -> int:
    """Return the run that holds the NaN node with flat index `at`."""
    low, high = 0, holes.hole_first.size  # the last run that begins at or before `at` is the one before `low`
    while low < high:
        middle = (low + high) >> 1
        if holes.hole_first[middle] <= at:
            low = middle + 1
        else:
            high = middle
    return low - 1


@kernel()
def filled_at(nodes: Float32Array, holes: Holes, at: int) -> float:
    """Return the height of the node with flat index `at`, or its ceiling where it is unknown."""
    height = nodes[at]
    if height == height:
        return height
    run = run_of(holes, at)
    return holes.ceilings[holes.hole_start[run] + at - holes.hole_first[run]]


@kernel()
def in_outer_hole(nodes: Float32Array, holes: Holes, at: int) -> bool:
    """Return whether the node with flat index `at` belongs to an outer hole."""
    return nodes[at] != nodes[at] and holes.hole_outer[run_of(holes, at)]


def _runs(elevation: Float32Array) -> tuple[Int64Array, Int64Array, Int64Array]:
    """Return the row, first column and one past the last column of each run of NaN, row after row."""
    parts = []
    for top in range(0, len(elevation), _ROWS):
        unknown = np.isnan(elevation[top : top + _ROWS]).view(np.int8)
        edges = np.diff(unknown, axis=1, prepend=np.int8(0), append=np.int8(0))
        row, first = np.nonzero(edges == 1)
        parts.append((top + row, first, np.nonzero(edges == -1)[1]))
    row, first, end = (np.concatenate(column) for column in zip(*parts, strict=True))
    return row, first, end


def _joined(row: Int64Array, first: Int64Array, end: Int64Array, width: int) -> Int64Array:
    """For each run the number of its hole: runs that touch, at corners too, are one."""
    from scipy.sparse import coo_array  # here, because few DEMs have holes and SciPy takes long to load
    from scipy.sparse.csgraph import connected_components

    above = (row - 1) * (width + 1)
    lowest = np.searchsorted(row * (width + 1) + end, above + first)
    count = np.searchsorted(row * (width + 1) + first, above + end, "right") - lowest
    touching = np.arange(count.sum()) + np.repeat(lowest - np.cumsum(count) + count, count)
    pairs = coo_array((np.ones(len(touching)), (np.repeat(np.arange(row.size), count), touching)), (row.size, row.size))
    return np.asarray(connected_components(pairs, directed=False)[1], np.int64)


@kernel()
def _rims(
    elevation: Float32Array, row: Int64Array, first: Int64Array, end: Int64Array, hole: Int64Array
) -> Float64Array:
    """For each run the highest known neighbour of its hole, +inf of one that reaches the raster's edge."""
    height, width = elevation.shape
    rim = np.full(row.size, -np.inf)
    for k in range(row.size):
        if row[k] == 0 or row[k] == height - 1 or first[k] == 0 or end[k] == width:
            rim[hole[k]] = np.inf
            continue
        for i in range(row[k] - 1, row[k] + 2):
            for j in range(first[k] - 1, end[k] + 1):
                if elevation[i, j] > rim[hole[k]]:
                    rim[hole[k]] = elevation[i, j]
    return rim[hole]


@kernel()
def _lowered(
    elevation: Float32Array,
    row: Int64Array,
    first: Int64Array,
    end: Int64Array,
    start: Int64Array,
    ceilings: Float32Array,
    straight: np.float32,
    diagonal: np.float32,
) -> bool:
    """Lower the ceilings to their neighbours' plus a step, over the rows downwards and then upwards; return whether any
    fell. Repeated until none falls: Borgefors, *Distance transformations in digital images*, CVGIP 34, 1986."""
    width = elevation.shape[1]
    fell = False
    # Filled heights of the row before and of the row itself, a place wider at both ends.
    before, here = np.full(width + 2, np.float32(np.inf)), np.full(width + 2, np.float32(np.inf))
    for step in (1, -1):
        k = 0 if step == 1 else row.size - 1
        held = -2
        while 0 <= k < row.size:
            i = row[k]
            if held != i - step:
                inside = 0 <= i - step < elevation.shape[0]
                for j in range(width):
                    before[1 + j] = elevation[i - step, j] if inside else np.inf  # it has no run, else it were held
            for j in range(width):
                here[1 + j] = elevation[i, j]
            from_run = k
            while 0 <= k < row.size and row[k] == i:
                for n in range(end[k] - first[k]):
                    here[1 + first[k] + n] = ceilings[start[k] + n]
                k += step
            run = from_run
            while run != k:
                length = end[run] - first[run]
                for n in range(length):
                    along = n if step == 1 else length - 1 - n
                    j = 1 + first[run] + along
                    least = min(min(here[j - step], before[j]) + straight, min(before[j - 1], before[j + 1]) + diagonal)
                    if least < here[j]:
                        here[j] = least
                        ceilings[start[run] + along] = least
                        fell = True
                run += step
            before, here = here, before
            held = i
    return fell
