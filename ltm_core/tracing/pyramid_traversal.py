"""Tracing kernels: the first point at which a ray meets the bilinear surface, found through the maximum pyramid.

Everything here is in *grid units*: x = column, y = row (nodes at integers), horizontal range q in cells, heights in
metres. A ray leaves (ox, oy, oz) along the horizontal vector (cx, cy), in lengths of which q is counted (1 cell, or
up to sqrt(2)); its height is z(q) = oz + s q + bend q^2, the parabola that earth curvature and refraction give it.
Blocks whose bound the ray clears are stepped over; the others are opened, down to cells, where the surface under the
ray is a quadratic in q and its first root the exact hit. A block is left through an edge with a whole coordinate, and
the next cell follows from that integer, never from a nudged position, so no cell can be skipped or met twice.

What ends a ray is defined in `tracer`; `ltm_lab.tracers.reference` computes the same by brute force."""

import math
from typing import NamedTuple

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float32Array, Float64Array, Int64Array, UInt8Array
from ltm_core.tracing.cell_intersection import FASTMATH, clearance, first_root, meets, ray_height, surface
from ltm_core.tracing.holes import Holes, filled_at, in_outer_hole
from ltm_core.tracing.pyramid import LEAF, MIXED, OUTSIDE, WITHIN

# Below this a ray is taken to be plumb: 10 km down it is then off by 10 micrometres.
PLUMB_SINE = 1e-9
# Cells: a hole that is crossed over less than this is only touched at a corner, and does not count.
TOUCH = 1e-9
START_LEVEL = 3


class TerrainRaster(NamedTuple):
    """One DEM raster as the kernels take it: nodes, holes and maximum pyramid."""

    nodes: Float32Array
    """Elevations, (height * width), row-major, NaN in holes."""
    holes: Holes
    width: int
    height: int
    bounds: Float32Array
    """Maximum pyramid of the nodes (`MaximumPyramid`), as are the next three."""
    offsets: Int64Array
    widths: Int64Array
    outside: UInt8Array
    top: float
    """Upper bound in metres of the ground in this raster, in the coarser ones around it, and beyond them."""


WHOLE, BEFORE, AFTER = 0, 1, 2
"""Part of a ray's way over a raster that counts: all of it, or the part before or after the next finer raster."""


class CellWindow(NamedTuple):
    """Edges of a raster's nodes relative to the camera in cells: x to the east, y to the south."""

    west: float
    north: float
    east: float
    south: float


class RasterStage(NamedTuple):
    """One raster's part in the ways of all rays from one position."""

    ox: float
    oy: float
    oz: float
    """Camera position: column, row, height in metres."""
    resolution: float
    """Metres per cell."""
    bend: float
    """The ray's bend coefficient per cell in grid units."""
    window: CellWindow
    finer: CellWindow
    """Window of the next finer raster; unused if the part is WHOLE."""
    part: int
    last: bool
    """Whether a ray without a hit in this raster has no hit at all."""
    rise: float
    """Maximum rise of unknown ground over a cell in metres."""
    highest: float
    """Maximum height of ground outside the DEM in metres."""


# A ray that has met nothing yet carries, in place of a range, what it has been over: a negative number.
FRESH = -1.0
"""Nothing is known so far."""
OVER_KNOWN = -2.0
"""The ray is over known ground."""


@helper(inline="always")
def _normal(c: float) -> float:
    """Return `c`, or 0 for a number so small that its reciprocal would overflow: a range of 0 times that is NaN."""
    return c if abs(c) > 1e-300 else 0.0


@helper(fastmath=FASTMATH)
def crossing(window: CellWindow, cx: float, cy: float) -> tuple[float, float]:
    """Return the ranges (q_in, q_out) between which a ray is over a window; q_in > q_out where it never is."""
    west, north, east, south = window
    q_in, q_out = 0.0, np.inf
    if cx != 0.0:
        inverse = 1.0 / cx
        q_in = max(q_in, min(west * inverse, east * inverse))
        q_out = min(q_out, max(west * inverse, east * inverse))
    elif west > 0.0 or east < 0.0:
        return 1.0, 0.0
    if cy != 0.0:
        inverse = 1.0 / cy
        q_in = max(q_in, min(north * inverse, south * inverse))
        q_out = min(q_out, max(north * inverse, south * inverse))
    elif north > 0.0 or south < 0.0:
        return 1.0, 0.0
    return q_in, q_out


@helper(fastmath=FASTMATH)
def stretch(stage: RasterStage, cx: float, cy: float) -> tuple[float, float]:
    """Return the ranges between which a ray's way belongs to a stage; start > end where none of it does."""
    start, end = crossing(stage.window, cx, cy)
    if stage.part == WHOLE:
        return start, end
    finer_in, finer_out = crossing(stage.finer, cx, cy)
    if finer_in > finer_out:
        return (start, end) if stage.part == BEFORE else (1.0, 0.0)
    if stage.part == BEFORE:
        return start, min(end, finer_in)
    return max(start, finer_out), end


@helper(fastmath=FASTMATH)
def finished(stage: RasterStage, cx: float, cy: float, s: float, bend: float, q: float) -> float:
    """Return the final result of a ray without a hit: +inf if it climbs out and no ground ahead can be as high or as
    steep, else NaN."""
    if not (stage.last and q < 0.0):
        return q
    leaves = crossing(stage.window, cx, cy)[1] if q == OVER_KNOWN else 0.0
    if s + 2.0 * bend * leaves < 0.0:
        return np.nan
    steep = s > 0.0 and s * s >= stage.rise * stage.rise * (cx * cx + cy * cy)
    return np.inf if steep or ray_height(stage.oz, s, bend, leaves) > stage.highest else np.nan


@helper(fastmath=FASTMATH)
def hit_between(
    ground: TerrainRaster,
    stage: RasterStage,
    cx: float,
    cy: float,
    s: float,
    bend: float,
    start: float,
    end: float,
    state: float,
    level: int,
) -> float:
    """Return the range q to the first hit from `start` to `end`, in lengths of (cx, cy); +inf for sky, NaN where it
    meets possible ground, and the ray's state where it has met nothing. `bend`: the stage's, or that for lengths other
    than a cell; `state`: that at `start`; `level`: that of the first block looked at."""
    nodes, width, height, top = ground.nodes, ground.width, ground.height, ground.top
    bounds, offsets, widths, outsides = ground.bounds, ground.offsets, ground.widths, ground.outside
    ox, oy, oz = stage.ox, stage.oy, stage.oz
    if start > end:
        return state
    x_last = width - 1
    y_last = height - 1
    inv_cx = 1.0 / cx if cx != 0.0 else np.inf
    inv_cy = 1.0 / cy if cy != 0.0 else np.inf
    climbs_on = bend >= 0.0 or (stage.last and s + 2.0 * bend * end >= 0.0)
    sag = 0.25 * max(bend, 0.0)  # the parabola lies at most sag * dq^2 below its chord
    ahead_x = 1 if cx > 0.0 else 0
    ahead_y = 1 if cy > 0.0 else 0

    q = start
    z = ray_height(oz, s, bend, q)
    ix = min(max(math.floor(ox + cx * q), 0), x_last - 1)
    iy = min(max(math.floor(oy + cy * q), 0), y_last - 1)
    level = min(level, offsets.size - 1) if level >= LEAF else 0
    entered = state != FRESH
    # From block to block along the ray: down a level where it may meet ground, on where it cannot.
    while True:
        above = 1 if level > 0 else LEAF
        bx = ix >> level
        by = iy >> level
        x0 = bx << level
        y0 = by << level
        x1 = min((bx + 1) << level, x_last)
        y1 = min((by + 1) << level, y_last)
        q_x = ((x1 if ahead_x else x0) - ox) * inv_cx if cx != 0.0 else np.inf
        q_y = ((y1 if ahead_y else y0) - oy) * inv_cy if cy != 0.0 else np.inf
        q_exit = min(max(min(q_x, q_y), q), end)
        z_exit = ray_height(oz, s, bend, q_exit)
        # A block: the ray passes above its bound, or its parts are tried.
        if level > 0:
            block = np.uint64(offsets[level] + by * widths[level] + bx)
            dq = q_exit - q
            outside = WITHIN if entered or outsides.size == 0 else outsides[block]
            if outside != OUTSIDE:
                if outside == MIXED or not min(z, z_exit) - sag * dq * dq > bounds[block]:
                    level = level - 1 if level > LEAF else 0
                    continue
                entered = True
        else:
            # A single cell: the bilinear surface, or the ceiling of a hole.
            at = np.uint64(iy * width + ix)
            below = np.uint64(at + np.uint64(width))
            h00 = float(nodes[at])
            h10 = float(nodes[at + np.uint64(1)])
            h01 = float(nodes[below])
            h11 = float(nodes[below + np.uint64(1)])
            b, e, g = surface(h00, h10, h01, h11)
            if g == g:
                u = ox + cx * q - ix
                v = oy + cy * q - iy
                dq = q_exit - q
                f0, f1, a = clearance(z, s, bend, q, cx, cy, h00, b, e, g, u, v)
                if f0 <= 0.0:
                    return np.nan if not entered and f0 < 0.0 else q
                if meets(f0, f1, a, dq):
                    return q + first_root(f0, f1, a, dq)
                entered = True
            elif q_exit - q > TOUCH:
                north = iy * width + ix
                if entered or not outside_cell(ground, north):
                    if lowest(oz, s, bend, q, q_exit) <= cell_ceiling(ground, north):
                        return np.nan
                    entered = True

        # Above all ground and climbing: sky.
        if climbs_on and entered and z_exit > top and s + 2.0 * bend * q_exit >= 0.0:
            return np.inf
        if q_exit >= end:
            break
        # On to the next block, up a level where the larger block ends too.
        q = q_exit
        z = z_exit
        if q_x <= q_y:
            ix = x1 if ahead_x else x0 - 1
            if ix < 0 or ix >= x_last:
                break
            iy = min(max(math.floor(oy + cy * q), y0), y1 - 1)
            if ((ix >> level) ^ bx) >> above != 0:
                level += above
        else:
            iy = y1 if ahead_y else y0 - 1
            if iy < 0 or iy >= y_last:
                break
            ix = min(max(math.floor(ox + cx * q), x0), x1 - 1)
            if ((iy >> level) ^ by) >> above != 0:
                level += above
        level = min(level, offsets.size - 1)
    return OVER_KNOWN if entered else FRESH


@helper()
def cell_ceiling(ground: TerrainRaster, at: int) -> float:
    """Return the highest that the ground may be in the cell whose north-west node is `at`."""
    highest = -np.inf
    for node in (at, at + 1, at + ground.width, at + ground.width + 1):
        highest = max(highest, float(filled_at(ground.nodes, ground.holes, node)))
    return highest


@helper()
def outside_cell(ground: TerrainRaster, at: int) -> bool:
    """Return whether the cell whose north-west node is `at` is an outer hole."""
    for node in (at, at + 1, at + ground.width, at + ground.width + 1):
        if in_outer_hole(ground.nodes, ground.holes, node):
            return True
    return False


@helper(fastmath=FASTMATH)
def lowest(oz: float, s: float, bend: float, q0: float, q1: float) -> float:
    """Return the least height of z(q) = oz + s q + bend q^2 on [q0, q1]."""
    z = min(oz + q0 * (s + bend * q0), oz + q1 * (s + bend * q1))
    if s + 2.0 * bend * q0 < 0.0 and s + 2.0 * bend * q1 > 0.0:
        z = min(z, oz - s * s / (4.0 * bend))
    return z


@helper(fastmath=FASTMATH)
def height_at(ground: TerrainRaster, x: float, y: float) -> float:
    """Return the bilinear height at grid position (x, y); NaN outside the nodes and in holes."""
    nodes, width, height = ground.nodes, ground.width, ground.height
    if not (0.0 <= x <= width - 1 and 0.0 <= y <= height - 1):
        return np.nan
    ix = min(int(x), width - 2)
    iy = min(int(y), height - 2)
    at = iy * width + ix
    u = x - ix
    v = y - iy
    h00 = float(nodes[at])
    b = nodes[at + 1] - h00
    e = nodes[at + width] - h00
    g = nodes[at + width + 1] - float(nodes[at + width]) - b
    h: float = h00 + b * u + v * (e + g * u)
    return h


@kernel(fastmath=FASTMATH, nogil=True)
def trace_directions(
    ground: TerrainRaster,
    stage: RasterStage,
    rotation: Float64Array,
    rays: Float64Array,
    first: bool,
    out: Float32Array,
) -> None:
    """Take rays from one origin through one stage. `rotation`: (3, 3) ray frame -> (east, north, up). `rays`: (N, 3)
    unit vectors; NaN gives NaN. `first`: vertical rays end here. `out`: (N,) float32, slant ranges in metres, or the
    states of rays that have met nothing, before this stage on entry, after it on return."""
    for k in range(rays.shape[0]):
        state = float(out[k])
        if not state < 0.0:
            continue
        a, b, c = rays[k, 0], rays[k, 1], rays[k, 2]
        east = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
        north = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
        up = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
        across = math.sqrt(east * east + north * north)
        if not (across == across and up == up):
            out[k] = np.nan
        elif across < PLUMB_SINE:
            if first:
                out[k] = np.inf if up > 0.0 else stage.oz - height_at(ground, stage.ox, stage.oy)
        else:
            cx, cy, s = east / across, -north / across, up / across * stage.resolution
            cx, cy = _normal(cx), _normal(cy)
            start, end = stretch(stage, cx, cy)
            level = np.int64(START_LEVEL)  # else `hit_between` is compiled for the literal, too
            q = hit_between(ground, stage, cx, cy, s, stage.bend, start, end, state, level)
            q = finished(stage, cx, cy, s, stage.bend, q)
            out[k] = q * stage.resolution / across if q >= 0.0 else q
