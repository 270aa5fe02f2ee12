"""Holes of a DEM: groups of nodata nodes, and what may be assumed about the ground inside them.

A *node* is a DEM cell centre; a *cell* of the tracer is the square between four nodes, on which the surface is
bilinear. A cell with any NaN node is a hole: its ground is unknown. Two kinds are told apart, because they mean
different things:

* An **enclosed** hole (a lake, a gap in a survey) is surrounded by known ground. Its ground is taken to be no higher
  than its *ceiling*, the highest known node that touches the group of NaN nodes. A ray may pass above the ceiling,
  not below it.
* An **outer** hole reaches the edge of the raster (the margin of a reprojected or clipped DEM). It has no ceiling; it
  is outside the DEM, as the space beyond the raster is.

Enclosed holes are held as runs of NaN nodes along rows, each with its ceiling: a few bytes a run, where a second
raster with the ceilings filled in would double the memory of a DEM that has one speck of nodata.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ltm_core.types import Float32Array, Float64Array, Int64Array


class Holes(NamedTuple):
    """Runs of NaN nodes of enclosed holes, in the order of their flat indices."""

    hole_first: Int64Array
    """Flat index (row * width + column) of a run's first node."""
    hole_end: Int64Array
    """One past its last."""
    hole_ceiling: Float32Array
    """Ceiling of the hole that the run belongs to."""


def find_holes(elevation: Float32Array) -> Holes:
    """The enclosed holes of (H, W) float32 elevations, NaN where nodata."""
    row, first, end = _runs(elevation, _count_runs(elevation))
    hole = _joined(row, first, end)
    ceiling = _ceilings(elevation, row, first, end, hole)
    enclosed = ceiling[hole] < np.inf
    width = elevation.shape[1]
    return Holes(
        (row * width + first)[enclosed], (row * width + end)[enclosed], ceiling[hole][enclosed].astype(np.float32)
    )


@njit(cache=True)  # type: ignore[untyped-decorator]
def filled_at(nodes: Float32Array, holes: Holes, at: int) -> float:
    """Height of the node with flat index `at`; of one in an enclosed hole, the hole's ceiling; NaN in an outer hole.

    `holes`: anything with the fields of `Holes`.
    """
    height = nodes[at]
    if height == height:
        return height
    low, high = 0, holes.hole_first.size  # the last run that begins at or before `at` is the one before `low`
    while low < high:
        middle = (low + high) >> 1
        if holes.hole_first[middle] <= at:
            low = middle + 1
        else:
            high = middle
    if low > 0 and at < holes.hole_end[low - 1]:
        return holes.hole_ceiling[low - 1]
    return height


@njit(cache=True)  # type: ignore[untyped-decorator]
def _count_runs(elevation: Float32Array) -> int:
    count = 0
    for i in range(elevation.shape[0]):
        before = False
        for j in range(elevation.shape[1]):
            missing = elevation[i, j] != elevation[i, j]
            count += missing and not before
            before = missing
    return count


@njit(cache=True)  # type: ignore[untyped-decorator]
def _runs(elevation: Float32Array, count: int) -> tuple[Int64Array, Int64Array, Int64Array]:
    """Row, first column and one past the last column of each run of NaN, row after row."""
    row, first, end = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    k = 0
    for i in range(elevation.shape[0]):
        before = False
        for j in range(elevation.shape[1]):
            missing = elevation[i, j] != elevation[i, j]
            if missing and not before:
                row[k], first[k] = i, j
            if before and not missing:
                end[k] = j
                k += 1
            before = missing
        if before:
            end[k] = elevation.shape[1]
            k += 1
    return row, first, end


@njit(cache=True)  # type: ignore[untyped-decorator]
def _joined(row: Int64Array, first: Int64Array, end: Int64Array) -> Int64Array:
    """For each run the index of one run that stands for all of its hole: runs that touch, at corners too, are one."""
    hole = np.arange(row.size)
    above = 0
    for k in range(row.size):
        while above < k and (row[above] < row[k] - 1 or (row[above] == row[k] - 1 and end[above] < first[k])):
            above += 1
        other = above
        while other < k and row[other] == row[k] - 1 and first[other] <= end[k]:
            a, b = _root(hole, other), _root(hole, k)
            hole[max(a, b)] = min(a, b)
            other += 1
    for k in range(row.size):
        hole[k] = _root(hole, k)
    return hole


@njit(cache=True)  # type: ignore[untyped-decorator]
def _root(hole: Int64Array, k: int) -> int:
    while hole[k] != k:
        hole[k] = hole[hole[k]]
        k = hole[k]
    return k


@njit(cache=True)  # type: ignore[untyped-decorator]
def _ceilings(
    elevation: Float32Array, row: Int64Array, first: Int64Array, end: Int64Array, hole: Int64Array
) -> Float64Array:
    """By the index of `hole`: its highest known neighbour, +inf of one that reaches the raster's edge."""
    height, width = elevation.shape
    ceiling = np.full(row.size, -np.inf)
    for k in range(row.size):
        if row[k] == 0 or row[k] == height - 1 or first[k] == 0 or end[k] == width:
            ceiling[hole[k]] = np.inf
            continue
        for i in range(row[k] - 1, row[k] + 2):
            for j in range(first[k] - 1, end[k] + 1):
                if elevation[i, j] > ceiling[hole[k]]:
                    ceiling[hole[k]] = elevation[i, j]
    return ceiling
