"""Occluding contours of terrain: ridges within the scene, behind which farther ground comes into view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from ltm_core.types import Float64Array, Int32Array, Int64Array

_MOST_RISE = 4.0
"""Steps of azimuth by which neighbours of a contour may differ in tangent,"""
_MOST_CHANGE = 0.12
"""and the logarithm by which they may differ in range."""
_SHORTEST = math.radians(0.6)
"""Contours that span less azimuth are left out: single trees and the DEM's noise."""


@dataclass(frozen=True, eq=False)
class OccludingContours:
    """Points of contours. (M,) each: `azimuth` (rad), `tangent`, `range` to the near side, `behind` and the
    DEM's `cell` there, metres, and `following`: the index of the contour's next point in azimuth, -1 at its end."""

    azimuth: Float64Array
    tangent: Float64Array
    range: Float64Array
    behind: Float64Array
    cell: Float64Array
    following: Int64Array

    def __len__(self) -> int:
        return len(self.azimuth)


def link_contours(start: float, step: float, points: Float64Array, found: Int32Array) -> OccludingContours:
    """Link points (N, K, 4) of N azimuths, of which `found` (N,) are set, each (tangent, range, range behind,
    cell), from one azimuth to the next; what stays shorter than 0.6 degrees is left out.
    """
    following, length = _link(points, found, step)
    kept = (np.arange(points.shape[1]) < found[:, None]) & (length * step >= _SHORTEST)
    rows, cols = np.nonzero(kept)
    number = np.full(kept.shape, -1, np.int64)
    number[rows, cols] = np.arange(len(rows))
    after = following[rows, cols]
    ends = (after < 0) | (rows + 1 >= len(found))
    linked = np.where(ends, -1, number[np.minimum(rows + 1, len(found) - 1), np.maximum(after, 0)])
    t, r, behind, cell = (values.copy() for values in points[rows, cols].T)
    return OccludingContours(np.asarray(start + step * rows, np.float64), t, r, behind, cell, linked)


@njit(cache=True, error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
def _link(points: Float64Array, found: Int32Array, step: float) -> tuple[Int32Array, Int32Array]:
    """Of each point the one that follows it at the next azimuth, -1 without, and its contour's number of points."""
    count, most = points.shape[0], points.shape[1]
    following = np.full((count, most), -1, np.int32)
    length = np.zeros((count, most), np.int32)
    taken = np.full((count, most), -1, np.int32)
    for k in range(count - 1):
        for i in range(found[k]):
            best, least = -1, 1.0
            for j in range(found[k + 1]):
                rise = abs(points[k + 1, j, 0] - points[k, i, 0]) / (_MOST_RISE * step)
                change = abs(math.log(points[k + 1, j, 1] / points[k, i, 1])) / _MOST_CHANGE
                if taken[k + 1, j] < 0 and rise < 1.0 and change < 1.0 and rise + change < 2 * least:
                    best, least = j, (rise + change) / 2
            if best >= 0:
                following[k, i] = best
                taken[k + 1, best] = i
    for k in range(count):
        for i in range(found[k]):
            if taken[k, i] < 0:  # a contour begins
                n, a, b = 0, k, i
                while b >= 0:
                    n, a, b = n + 1, a + 1, following[a, b]
                a, b = k, i
                while b >= 0:
                    length[a, b] = n
                    a, b = a + 1, following[a, b]
    return following, length
