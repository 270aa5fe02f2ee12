"""A slow, independent float64 tracer that visits every cell on a ray's path; tests hold the fast tracer against it.

It keeps the definition in `tracer` and shares nothing with `traversal`: instead of stepping, it takes all crossings of
a ray with grid lines at once, sorts them, and in each cell puts a parabola through three heights above the surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ltm_core.dem import Dem
from ltm_core.tracing.holes import with_ceilings

Floats = NDArray[np.float64]

TOUCH = 1e-9
"""Crossings of grid lines closer than this, in cells, are one: the ray goes through a node."""


def trace_reference(
    dem: Dem, origin: NDArray[np.float64], directions: NDArray[np.float64], bend: float
) -> NDArray[np.float64]:
    """Slant ranges in metres, (N,): finite, +inf sky, NaN unknown.

    Args:
        origin: (3,) x, y, z; above the ground.
        directions: (N, 3), of any length, none of them plumb.
        bend: curvature coefficient, 1/m.
    """
    nodes = dem.elevation.astype(np.float64)
    filled = with_ceilings(dem.elevation).astype(np.float64)
    row, col = (float(v) for v in dem.geometry.to_grid(origin[0], origin[1]))
    ranges = np.empty(len(directions))
    for k, (east, north, up) in enumerate(directions):
        across = float(np.hypot(east, north))
        metres = _horizontal_range(
            nodes,
            filled,
            (col, row, float(origin[2])),
            (east / across, -north / across),
            up / across,
            bend,
            dem.geometry.resolution,
        )
        ranges[k] = metres * float(np.hypot(1.0, up / across))
    return ranges


def _horizontal_range(
    nodes: Floats,
    filled: Floats,
    origin: tuple[float, float, float],
    heading: tuple[float, float],
    slope: float,
    bend: float,
    resolution: float,
) -> float:
    """Horizontal range in metres to the first hit; origin is (column, row, height), heading a unit (column, row)
    vector.
    """
    ox, oy, oz = origin
    cx, cy = heading
    height, width = nodes.shape
    near, far = 0.0, np.inf
    for o, c, last in ((ox, cx, width - 1), (oy, cy, height - 1)):
        if c == 0:
            if not 0 <= o <= last:
                near, far = 1.0, 0.0
        else:
            a, b = sorted(((0 - o) / c, (last - o) / c))
            near, far = max(near, a), min(far, b)
    if near > far:
        return np.inf if slope >= 0 else np.nan
    beyond = np.inf if slope + 2 * bend * far * resolution >= 0 else np.nan

    cuts = [np.array([near, far])]
    if cx != 0:
        cuts.append((np.arange(width) - ox) / cx)
    if cy != 0:
        cuts.append((np.arange(height) - oy) / cy)
    q = np.unique(np.concatenate(cuts))
    q = q[(q >= near) & (q <= far)]
    q = q[np.diff(q, prepend=-np.inf) > TOUCH]
    start, end = q[:-1], q[1:]
    middle = (start + end) / 2
    i = np.clip(np.floor(oy + cy * middle).astype(int), 0, height - 2)
    j = np.clip(np.floor(ox + cx * middle).astype(int), 0, width - 2)

    def ray_height(q: Floats) -> Floats:
        r = q * resolution
        return np.asarray(oz + slope * r + bend * r * r)

    def above(q: Floats) -> Floats:
        u, v = ox + cx * q - j, oy + cy * q - i
        north = (1 - u) * nodes[i, j] + u * nodes[i, j + 1]
        south = (1 - u) * nodes[i + 1, j] + u * nodes[i + 1, j + 1]
        return np.asarray(ray_height(q) - ((1 - v) * north + v * south))

    root = _first_roots(above(start), above(middle), above(end))
    corners = np.stack([filled[i, j], filled[i, j + 1], filled[i + 1, j], filled[i + 1, j + 1]])
    hole = np.isnan(nodes[i, j] + nodes[i, j + 1] + nodes[i + 1, j] + nodes[i + 1, j + 1])
    outer = np.isnan(corners).any(axis=0)
    lowest = np.minimum(ray_height(start), ray_height(end))
    if bend > 0:
        bottom = -slope / (2 * bend) / resolution
        lowest = np.where((start < bottom) & (bottom < end), ray_height(np.array(bottom)), lowest)
    with np.errstate(invalid="ignore"):
        blocked = hole & ~outer & (lowest <= np.where(outer, np.inf, corners.max(axis=0)))
    hit = ~hole & ~np.isnan(root)

    ends = np.flatnonzero(hit | blocked)
    if ends.size == 0:
        return float(beyond)
    first = int(ends[0])
    if blocked[first]:
        return np.nan
    known_before = ~outer[:first]
    entered = int(np.argmax(known_before)) if known_before.any() else first
    lost = bool(outer[entered:first].any())
    emerges_below = entered == first and above(start)[first] < 0
    if lost or emerges_below:
        return np.nan
    return float((start[first] + root[first] * (end[first] - start[first])) * resolution)


def _first_roots(f0: Floats, f_half: Floats, f1: Floats) -> Floats:
    """First place in [0, 1] where the parabola through (0, f0), (1/2, f_half), (1, f1) is not positive; NaN where
    none is.
    """
    a = 2 * (f0 - 2 * f_half + f1)
    b = -3 * f0 + 4 * f_half - f1
    with np.errstate(invalid="ignore", divide="ignore"):
        bottom = np.clip(np.where(a > 0, -b / (2 * a), 1.0), 0.0, 1.0)
        least = np.minimum(f1, f0 + bottom * (b + a * bottom))
        discriminant = np.sqrt(np.maximum(b * b - 4 * a * f0, 0.0))
        root = np.where(b <= 0, 2 * f0 / (discriminant - b), (-b - discriminant) / (2 * a))
        root = np.where(f0 <= 0, 0.0, np.clip(root, 0.0, 1.0))
        return np.where((f0 <= 0) | (least <= 0), root, np.nan)
