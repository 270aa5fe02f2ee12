"""Occlusion kernels: the steepest slope of the terrain between a camera and a point, found by the maximum pyramid.

Grid units as in `tracing.pyramid_traversal`: x = column, y = row, range q in cells, heights in metres, a ray at
z(q) = oz + s q + bend q^2. Ground of height h at range q meets the ray of slope f(q) = (h(q) - oz) / q - bend q. The
slope that clears all ground before a point is the supremum of f; in one cell h is a quadratic in q, so f has its
maximum at an end of the crossing or where its derivative vanishes, in closed form. A block of the maximum pyramid is
stepped over when ground as high as its bound, anywhere in it, would not raise the supremum."""

import math

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.tracing.pyramid import LEAF, MIXED, OUTSIDE, WITHIN
from ltm_core.tracing.pyramid_traversal import (
    TOUCH,
    RasterStage,
    TerrainRaster,
    cell_ceiling,
    height_at,
    outside_cell,
    stretch,
)

BY_CEILING, OVER_KNOWN, BEYOND = 1, 2, 4
"""Result of a way: the highest obstacle is a hole's ceiling; it is known ground; the terrain ends before the target."""


@kernel(nogil=True)
def raise_slopes(
    ground: TerrainRaster,
    stage: RasterStage,
    first: bool,
    targets: Float64Array,
    slopes: Float64Array,
    came_to: UInt8Array,
) -> None:
    """Take the ways to targets (N, 3: column, row of the stage's raster, z) through one stage.

    `slopes`: (N,) m/m, the greatest slope f of the ground so far, or the target's own where that is greater; NaN for a
    target that is not finite. `first`: the camera stands over this stage's raster, so that plumb ways end here."""
    for k in range(len(targets)):
        dx, dy, z = targets[k, 0] - stage.ox, targets[k, 1] - stage.oy, targets[k, 2]
        q = math.hypot(dx, dy)
        if slopes[k] != slopes[k]:
            continue
        if q * stage.resolution < 1e-6:  # plumb above or below the camera: the ground between them decides
            if first:
                ground_height = height_at(ground, stage.ox, stage.oy)
                if ground_height == ground_height:
                    slopes[k] = max(0.0, ground_height - z)
                    came_to[k] |= OVER_KNOWN
            continue
        slope, found = blocking_slope(
            ground, stage, dx / q, dy / q, q, slopes[k] * stage.resolution, came_to[k] & OVER_KNOWN > 0
        )
        if slope > slopes[k] * stage.resolution:
            came_to[k] &= np.uint8(255 - BY_CEILING)
        slopes[k] = slope / stage.resolution
        came_to[k] |= found


@helper()
def blocking_slope(
    ground: TerrainRaster, stage: RasterStage, cx: float, cy: float, q_end: float, least: float, over_known: bool
) -> tuple[float, np.uint8]:
    """Return the maximum slope f(q) of the ground over the stage's part of 0 < q <= q_end, or `least` if that is
    greater; and the state of the way there. `over_known`: it has been over known ground before; outer holes are free
    until then."""
    nodes, bounds, height, width = ground.nodes, ground.bounds, ground.height, ground.width
    ox, oy, oz, bend = stage.ox, stage.oy, stage.oz, stage.bend
    top_level = len(ground.offsets) - 1
    inv_cx = 1.0 / cx if cx != 0 else np.inf
    inv_cy = 1.0 / cy if cy != 0 else np.inf
    q, q_out = stretch(stage, cx, cy)
    beyond = stage.last and (q > q_out or q_out < q_end - 1e-9)
    q_out = min(q_out, q_end)
    if q > q_out:
        return least, np.uint8(BEYOND if beyond else 0)
    j = min(max(math.floor(ox + cx * q), 0), width - 2)
    i = min(max(math.floor(oy + cy * q), 0), height - 2)
    best = least
    by_ceiling = False
    level = min(LEAF, top_level)
    # From block to block towards the point: down a level if the block may hold a steeper slope.
    while True:
        i0, j0 = (i >> level) << level, (j >> level) << level
        size = 1 << level
        x_edge = j0 + size if cx > 0 else j0
        y_edge = i0 + size if cy > 0 else i0
        q_x = (x_edge - ox) * inv_cx if cx != 0 else np.inf
        q_y = (y_edge - oy) * inv_cy if cy != 0 else np.inf
        q_exit = max(q, min(q_x, q_y, q_out))
        if level > 0:
            block = ground.offsets[level] + (i >> level) * ground.widths[level] + (j >> level)
            outside = WITHIN if over_known or ground.outside.size == 0 else ground.outside[block]
            if outside != OUTSIDE:
                if outside == MIXED or _slope_below(bounds[block], oz, bend, q, q_exit) > best:
                    level = level - 1 if level > LEAF else 0
                    continue
                over_known = True
        else:
            at = i * width + j
            a, b = np.float64(nodes[at]), np.float64(nodes[at + 1])
            c, d = np.float64(nodes[at + width]), np.float64(nodes[at + width + 1])
            if not np.isnan(a + b + c + d):
                over_known = True
                slope = _cell_slope(a, b, c, d, ox - j, oy - i, oz, cx, cy, q, q_exit, bend)
                if slope > best:
                    best, by_ceiling = slope, False
            elif q_exit - q > TOUCH and (over_known or not outside_cell(ground, at)):
                over_known = True
                slope = _slope_below(cell_ceiling(ground, at), oz, bend, q, q_exit)
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
        elif i >> LEAF != i0 >> LEAF or j >> LEAF != j0 >> LEAF:
            level = min(LEAF, top_level)
    found = (BY_CEILING if by_ceiling else 0) | (OVER_KNOWN if over_known else 0) | (BEYOND if beyond else 0)
    return best, np.uint8(found)


@helper()
def _slope_below(top: float, oz: float, bend: float, q0: float, q1: float) -> float:
    """Return an upper bound of f over [q0, q1] for ground no higher than `top`."""
    rise = top - oz
    if rise > 0:
        return np.inf if q0 <= 0 else rise / q0 - bend * q0
    return rise / q1 - bend * q0 if q1 > 0 else -np.inf


@helper()
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
    """Return the maximum of f over [q0, q1] in a cell with corners a, b (north) and c, d (south); (x, y): the camera
    from its north-west corner."""
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
