"""The tracing kernels: the first point at which a ray meets the bilinear surface, by way of the maximum pyramid.

Everything here is in *grid units*: x = column, y = row (nodes at integers), horizontal range q in cells, heights in
metres. A ray leaves (ox, oy, oz) along the horizontal vector (cx, cy), in lengths of which q is counted (1 cell, or
up to sqrt(2)); its height is z(q) = oz + s q + bend q^2, the parabola that earth curvature and refraction give it.
Blocks whose bound the ray clears are stepped over; the others are opened, down to cells, where the surface under the
ray is a quadratic in q and its first root the exact hit. A block is left through an edge with a whole coordinate, and
the next cell follows from that integer, never from a nudged position, so no cell can be skipped or met twice.

What ends a ray is defined in `tracer`; `reference` computes the same by brute force.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ltm_core.tracing.pyramid import LEAF

Floats = NDArray[np.float64]

# Contracting to FMA is safe; nnan and ninf would break the NaN and infinity that mean hole and sky.
_FASTMATH = {"contract", "nsz"}
# Below this a ray is taken to be plumb: 10 km down it is then off by 10 micrometres.
PLUMB_SINE = 1e-9
# Cells: a hole that is crossed over less than this is only touched at a corner, and does not count.
TOUCH = 1e-9
_START_LEVEL = 3
_CHUNK = 2048
_TASKS = 128


class Ground(NamedTuple):
    """What the kernels know of the terrain."""

    nodes: NDArray[np.float32]
    """(height * width) elevations, row-major, NaN in holes."""
    filled: NDArray[np.float32]
    """The same with the ceilings of enclosed holes (`holes.with_ceilings`)."""
    width: int
    height: int
    bounds: NDArray[np.float32]
    """The `MaximumPyramid` of `filled`, as are the next two."""
    offsets: NDArray[np.int64]
    widths: NDArray[np.int64]
    top: float
    """The highest elevation."""


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)  # type: ignore[untyped-decorator]
def first_hit(ground: Ground, ox: float, oy: float, oz: float, cx: float, cy: float, s: float, bend: float) -> float:
    """Range q to the first hit, in lengths of (cx, cy); +inf for sky, NaN for unknown."""
    return hit_from(ground, ox, oy, oz, cx, cy, s, bend, 0.0, False, _START_LEVEL)


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)  # type: ignore[untyped-decorator]
def hit_from(
    ground: Ground,
    ox: float,
    oy: float,
    oz: float,
    cx: float,
    cy: float,
    s: float,
    bend: float,
    start: float,
    entered: bool,
    level: int,
) -> float:
    """`first_hit` of a ray that is known to meet nothing before q = `start`.

    `entered`: whether it has been over known ground until there; `level`: that of the first block looked at.
    """
    nodes, filled, width, height, top = ground.nodes, ground.filled, ground.width, ground.height, ground.top
    bounds, offsets, widths = ground.bounds, ground.offsets, ground.widths
    x_last = width - 1
    y_last = height - 1
    q_in = 0.0
    q_out = np.inf
    inv_cx = np.inf
    inv_cy = np.inf
    missed = False
    if cx != 0.0:
        inv_cx = 1.0 / cx
        q_west = (0.0 - ox) * inv_cx
        q_east = (x_last - ox) * inv_cx
        q_in = max(q_in, min(q_west, q_east))
        q_out = min(q_out, max(q_west, q_east))
    elif ox < 0.0 or ox > x_last:
        missed = True
    if cy != 0.0:
        inv_cy = 1.0 / cy
        q_north = (0.0 - oy) * inv_cy
        q_south = (y_last - oy) * inv_cy
        q_in = max(q_in, min(q_north, q_south))
        q_out = min(q_out, max(q_north, q_south))
    elif oy < 0.0 or oy > y_last:
        missed = True
    if missed or q_in > q_out:
        return np.inf if s >= 0.0 else np.nan
    rises_at_exit = s + 2.0 * bend * q_out >= 0.0
    beyond = np.inf if rises_at_exit else np.nan
    q_in = max(q_in, start)
    if q_in > q_out:
        return beyond
    sag = 0.25 * max(bend, 0.0)  # the parabola lies at most sag * dq^2 below its chord
    ahead_x = 1 if cx > 0.0 else 0
    ahead_y = 1 if cy > 0.0 else 0

    q = q_in
    z = oz + q * (s + bend * q)
    ix = min(max(math.floor(ox + cx * q), 0), x_last - 1)
    iy = min(max(math.floor(oy + cy * q), 0), y_last - 1)
    level = min(level, offsets.size - 1) if level >= LEAF else 0
    lost = False  # has it crossed an outer hole since it was over known ground?
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
        q_exit = max(min(q_x, q_y), q)
        z_exit = oz + q_exit * (s + bend * q_exit)
        if level > 0:
            bound = bounds[np.uint64(offsets[level] + by * widths[level] + bx)]
            dq = q_exit - q
            if min(z, z_exit) - sag * dq * dq > bound:
                entered = True
            elif bound != bound:
                lost = lost or (entered and dq > TOUCH)
            else:
                level = level - 1 if level > LEAF else 0
                continue
        else:
            at = np.uint64(iy * width + ix)
            below = np.uint64(at + np.uint64(width))
            h00 = float(nodes[at])
            h01 = float(nodes[at + np.uint64(1)])
            h10 = float(nodes[below])
            h11 = float(nodes[below + np.uint64(1)])
            b = h01 - h00
            e = h10 - h00
            g = h11 - h10 - b
            if g == g:
                u = ox + cx * q - ix
                v = oy + cy * q - iy
                dq = q_exit - q
                f0 = z - (h00 + b * u + v * (e + g * u))
                if f0 <= 0.0:
                    return np.nan if lost or (not entered and f0 < 0.0) else q
                f1 = s + 2.0 * bend * q - (b + g * v) * cx - (e + g * u) * cy
                a = bend - g * cx * cy
                discriminant = f1 * f1 - 4.0 * a * f0
                crosses = f0 + dq * (f1 + a * dq) <= 0.0
                dips = f1 < 0.0 and f1 + 2.0 * a * dq > 0.0 and discriminant >= 0.0
                if crosses or dips:
                    step = 2.0 * f0 / (-f1 + math.sqrt(max(discriminant, 0.0)))
                    return np.nan if lost else q + min(step, dq)
                entered = True
            elif q_exit - q > TOUCH:
                ceiling_west = max(filled[at], filled[below])
                ceiling_east = max(filled[at + np.uint64(1)], filled[below + np.uint64(1)])
                outer = filled[at] + filled[at + np.uint64(1)] + filled[below] + filled[below + np.uint64(1)]
                if outer != outer:
                    lost = lost or entered
                elif lowest(oz, s, bend, q, q_exit) <= max(ceiling_west, ceiling_east):
                    return np.nan
                else:
                    entered = True

        if rises_at_exit and z_exit > top and s + 2.0 * bend * q_exit >= 0.0:
            return np.inf
        q = q_exit
        z = z_exit
        if q_x <= q_y:
            ix = x1 if ahead_x else x0 - 1
            if ix < 0 or ix >= x_last:
                return beyond
            iy = min(max(math.floor(oy + cy * q), y0), y1 - 1)
            if ((ix >> level) ^ bx) >> above != 0:
                level += above
        else:
            iy = y1 if ahead_y else y0 - 1
            if iy < 0 or iy >= y_last:
                return beyond
            ix = min(max(math.floor(ox + cx * q), x0), x1 - 1)
            if ((iy >> level) ^ by) >> above != 0:
                level += above
        level = min(level, offsets.size - 1)


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)  # type: ignore[untyped-decorator]
def lowest(oz: float, s: float, bend: float, q0: float, q1: float) -> float:
    """The least height of z(q) = oz + s q + bend q^2 on [q0, q1]."""
    z = min(oz + q0 * (s + bend * q0), oz + q1 * (s + bend * q1))
    if s + 2.0 * bend * q0 < 0.0 and s + 2.0 * bend * q1 > 0.0:
        z = min(z, oz - s * s / (4.0 * bend))
    return z


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)  # type: ignore[untyped-decorator]
def height_at(ground: Ground, x: float, y: float) -> float:
    """Bilinear height at grid position (x, y); NaN outside the nodes and in holes."""
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


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH, parallel=True, nogil=True)  # type: ignore[untyped-decorator]
def trace_directions(
    ground: Ground,
    ox: float,
    oy: float,
    oz: float,
    rotation: Floats,
    rays: Floats,
    resolution: float,
    bend: float,
    out: NDArray[np.float32],
) -> None:
    """Slant range in metres along each ray from one origin, into `out` (N,) float32.

    Args:
        ox, oy, oz: origin: column, row, height in metres.
        rotation: (3, 3) float64, ray frame -> (east, north, up).
        rays: (N, 3) float64 unit vectors; a NaN one gives NaN.
        resolution: metres a cell; `bend`: 1/m.
    """
    n_chunks = (rays.shape[0] + _CHUNK - 1) // _CHUNK
    for task in prange(_TASKS):
        # Chunks are dealt out in turn: rows near the horizon cost several times what sky and foreground do.
        for chunk in range(task, n_chunks, _TASKS):
            for k in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, rays.shape[0])):
                a, b, c = rays[k, 0], rays[k, 1], rays[k, 2]
                east = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
                north = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
                up = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
                across = math.sqrt(east * east + north * north)
                if not (across == across and up == up):
                    out[k] = np.nan
                elif across < PLUMB_SINE:
                    out[k] = np.inf if up > 0.0 else oz - height_at(ground, ox, oy)
                else:
                    cx, cy, s = east / across, -north / across, up / across * resolution
                    q = first_hit(ground, ox, oy, oz, cx, cy, s, bend * resolution * resolution)
                    out[k] = q * resolution / across
