"""How high the terrain stands before a point, seen from a camera: the greatest slope on the way, by way of the pyramid.

Grid units as in `tracing.traversal`: x = column, y = row, range q in cells, heights in metres, a ray at
z(q) = oz + s q + bend q^2. Ground of height h at range q meets the ray of slope f(q) = (h(q) - oz) / q - bend q. The
slope that clears all ground before a point is the supremum of f; in one cell h is a quadratic in q, so f has its
maximum at an end of the crossing or where its derivative vanishes, in closed form. A block of the maximum pyramid is
stepped over when ground as high as its bound, anywhere in it, would not raise the supremum.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_LEAF = 2
"""Below this level of the pyramid single cells are looked at."""


class SightTerrain(NamedTuple):
    """What the kernels know of the terrain."""

    nodes: NDArray[np.float32]
    """(H, W) elevations, NaN in holes."""
    filled: NDArray[np.float32]
    """The same with the ceilings of enclosed holes (`tracing.holes`)."""
    bounds: NDArray[np.float32]
    """The `MaximumPyramid` of `filled`, as are the next two."""
    offsets: NDArray[np.int64]
    widths: NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def lifts(
    terrain: SightTerrain, ox: float, oy: float, oz: float, bend: float, targets: Floats, out: Floats, unknown: Floats
) -> None:
    """For each target (N, 3: x, y, z) the metres by which it must be raised to be seen: 0 where it is.

    `unknown` is 1 where nothing known hides the target but ground that is not known might.
    """
    for k in range(len(targets)):
        dx, dy, z = targets[k, 0] - ox, targets[k, 1] - oy, targets[k, 2]
        q = math.hypot(dx, dy)
        if not math.isfinite(q + z):
            out[k], unknown[k] = np.nan, 1.0
        elif q < 1e-6:  # plumb above or below the camera: the ground between them decides
            out[k], unknown[k] = _plumb_lift(terrain.nodes, ox, oy, z)
        else:
            own = (z - oz) / q - bend * q
            slope, out_of_known = blocking_slope(terrain, ox, oy, oz, dx / q, dy / q, q, bend, own)
            out[k] = (slope - own) * q
            unknown[k] = out_of_known


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _plumb_lift(nodes: NDArray[np.float32], x: float, y: float, z: float) -> tuple[float, float]:
    if not (0 <= x <= nodes.shape[1] - 1 and 0 <= y <= nodes.shape[0] - 1):
        return 0.0, 1.0
    j, i = min(int(x), nodes.shape[1] - 2), min(int(y), nodes.shape[0] - 2)
    u, v = x - j, y - i
    top = (1 - u) * nodes[i, j] + u * nodes[i, j + 1]
    bottom = (1 - u) * nodes[i + 1, j] + u * nodes[i + 1, j + 1]
    ground = (1 - v) * top + v * bottom
    if np.isnan(ground):
        return 0.0, 1.0
    return max(0.0, ground - z), 0.0


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def blocking_slope(
    terrain: SightTerrain,
    ox: float,
    oy: float,
    oz: float,
    cx: float,
    cy: float,
    q_end: float,
    bend: float,
    least: float,
) -> tuple[float, float]:
    """The greatest slope f(q) of the ground over 0 < q <= q_end, or `least` if that is greater; and 1 if it is not
    known ground that decides: an enclosed hole's ceiling is the highest, or nothing known is above `least` and the way
    leads over outer holes or beyond the raster.
    """
    nodes, filled, bounds = terrain.nodes, terrain.filled, terrain.bounds
    height, width = nodes.shape
    top_level = len(terrain.offsets) - 1
    inv_cx = 1.0 / cx if cx != 0 else np.inf
    inv_cy = 1.0 / cy if cy != 0 else np.inf
    q, q_out = _over_raster(ox, oy, cx, cy, inv_cx, inv_cy, q_end, width - 1, height - 1)
    if q > q_out:
        return least, 1.0
    beyond = q_out < q_end - 1e-9
    j = min(max(math.floor(ox + cx * q), 0), width - 2)
    i = min(max(math.floor(oy + cy * q), 0), height - 2)
    best = least
    by_ceiling = left_known = over_known = False
    level = min(_LEAF, top_level)
    while True:
        i0, j0 = (i >> level) << level, (j >> level) << level
        size = 1 << level
        x_edge = j0 + size if cx > 0 else j0
        y_edge = i0 + size if cy > 0 else i0
        q_x = (x_edge - ox) * inv_cx if cx != 0 else np.inf
        q_y = (y_edge - oy) * inv_cy if cy != 0 else np.inf
        q_exit = max(q, min(q_x, q_y, q_out))
        if level > 0:
            bound = bounds[terrain.offsets[level] + (i >> level) * terrain.widths[level] + (j >> level)]
            if bound == bound and _slope_below(bound, oz, bend, q, q_exit) > best:
                level = level - 1 if level > _LEAF else 0
                continue
            if bound == bound:
                over_known = True
            elif over_known and q_exit - q > 1e-9:
                left_known = True
        else:
            a, b = np.float64(nodes[i, j]), np.float64(nodes[i, j + 1])
            c, d = np.float64(nodes[i + 1, j]), np.float64(nodes[i + 1, j + 1])
            if not np.isnan(a + b + c + d):
                over_known = True
                slope = _cell_slope(a, b, c, d, ox - j, oy - i, oz, cx, cy, q, q_exit, bend)
                if slope > best:
                    best, by_ceiling = slope, False
            elif q_exit - q > 1e-9:
                ceiling = np.float64(
                    max(
                        max(filled[i, j], filled[i, j + 1]),
                        max(filled[i + 1, j], filled[i + 1, j + 1]),
                    )
                )
                if np.isnan(filled[i, j] + filled[i, j + 1] + filled[i + 1, j] + filled[i + 1, j + 1]):
                    left_known = left_known or over_known
                else:
                    over_known = True
                    slope = _slope_below(ceiling, oz, bend, q, q_exit)
                    if slope > best:
                        best, by_ceiling = slope, True
        if q_exit >= q_out:
            break
        # The next cell follows from the whole coordinate of the edge, the other one never runs backwards.
        if q_x <= q_y:
            j = x_edge if cx > 0 else x_edge - 1
            row = math.floor(oy + cy * q_exit)
            i = min(max(row, i), i0 + size - 1) if cy > 0 else max(min(row, i), i0)
        else:
            i = y_edge if cy > 0 else y_edge - 1
            col = math.floor(ox + cx * q_exit)
            j = min(max(col, j), j0 + size - 1) if cx > 0 else max(min(col, j), j0)
        if not (0 <= i <= height - 2 and 0 <= j <= width - 2):
            break
        q = q_exit
        if level > 0:
            level = min(level + 1, top_level)
        elif i >> _LEAF != i0 >> _LEAF or j >> _LEAF != j0 >> _LEAF:
            level = min(_LEAF, top_level)
    uncertain = by_ceiling or (best <= least and (left_known or beyond or not over_known))
    return best, 1.0 if uncertain else 0.0


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _over_raster(
    ox: float, oy: float, cx: float, cy: float, inv_cx: float, inv_cy: float, q_end: float, x_last: float, y_last: float
) -> tuple[float, float]:
    """The part (q_in, q_out) of a way that lies over the nodes; q_in > q_out where none does."""
    q_in, q_out = 0.0, q_end
    for o, c, inverse, last in ((ox, cx, inv_cx, x_last), (oy, cy, inv_cy, y_last)):
        if c != 0.0:
            a, b = (0.0 - o) * inverse, (last - o) * inverse
            q_in, q_out = max(q_in, min(a, b)), min(q_out, max(a, b))
        elif o < 0.0 or o > last:
            return 1.0, 0.0
    return q_in, q_out


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _slope_below(top: float, oz: float, bend: float, q0: float, q1: float) -> float:
    """An upper bound of f over [q0, q1] for ground no higher than `top`."""
    rise = top - oz
    if rise > 0:
        return np.inf if q0 <= 0 else rise / q0 - bend * q0
    return rise / q1 - bend * q0 if q1 > 0 else -np.inf


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _cell_slope(
    a: float,
    b: float,
    c: float,
    d: float,
    x: float,
    y: float,
    oz: float,
    cx: float,
    cy: float,
    q0: float,
    q1: float,
    bend: float,
) -> float:
    """The maximum of f over [q0, q1] in a cell with corners a, b (north) and c, d (south); (x, y): the camera from its
    north-west corner.
    """
    east, south, twist = b - a, c - a, a - b - c + d
    # Along the way, h - oz = constant + linear q + square q^2.
    constant = a + east * x + south * y + twist * x * y - oz
    linear = east * cx + south * cy + twist * (x * cy + y * cx)
    square = twist * cx * cy - bend
    best = -np.inf
    if q0 > 0:
        best = constant / q0 + linear + square * q0
    if q1 > 0:
        best = max(best, constant / q1 + linear + square * q1)
    if constant < 0 and square < 0:
        peak = math.sqrt(constant / square)
        if q0 < peak < q1:
            best = max(best, constant / peak + linear + square * peak)
    return best
