"""The fast path's kernels for eight rays at once: turn them into the grid, and go through cells.

They do what `sweep` does one ray at a time, and leave what is rare to it. Rays of a group take the same steps, so that
one which needs many would hold up seven: after a few steps, those that are still on their way leave their group and
wait in a list, from which full groups are made again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ltm_core.tracing.cell_intersection import FASTMATH, clearance, first_root, meets, ray_height, surface
from ltm_core.tracing.column_block import (
    ANSWERED,
    FACE,
    MEETS_NOTHING,
    NEAR,
    PER_MAJOR,
    SLOPE,
    WEDGE,
    T,
)
from ltm_core.tracing.horizon_profile import WEDGES_A_FACE
from ltm_core.tracing.lanes import (
    WIDTH,
    any_of,
    compressed,
    count_of,
    floor_of,
    gather,
    gather_pair,
    is_set,
    lane_numbers,
    load,
    load_triples,
    select,
    size_of,
    store,
    to_floats,
    to_ints,
)
from ltm_core.tracing.pyramid_traversal import (
    OVER_KNOWN,
    PLUMB_SINE,
    RasterStage,
    TerrainRaster,
    finished,
    hit_between,
    over_raster,
)
from ltm_core.types import Float32Array, Float64Array

FIRST_STEPS, MORE_STEPS, MOST_ROUNDS = 4, 8, 6
"""Cells that a group goes through at once: at first, from the list, and how often the latter."""
_ROOM = 144


# Fields of the list of rays that wait, each a stretch of _ROOM float64 of one flat array, at these indices.
_CX, _CY, _S, _BEND, _SCALE, _PLACE, _ROUNDS, _Q, _X, _Y = range(0, 10 * _ROOM, _ROOM)
"""cx, cy, s, bend; slant metres a length of q; flat index of the pixel; how often it was taken from the list; where the
ray is: its range, and its cell's column and row.
"""
_UNCHANGED = (_CX, _CY, _S, _BEND, _SCALE, _PLACE)


@njit(cache=True)  # type: ignore[untyped-decorator]
def no_rays() -> Float64Array:
    """An empty list of rays."""
    return np.empty(10 * _ROOM)


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def turn_lanes(
    rays: Float64Array, at: int, groups: int, rotation: Float64Array, resolution: float, block: Float64Array
) -> None:
    """Turn `groups` of flat rays, from index `at` on, into the grid; see `sweep.turn`."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for g in range(groups):
        a, b, c = load_triples(rays, at + 3 * WIDTH * g)
        east = a * r00 + b * r01 + c * r02
        south = -(a * r10 + b * r11 + c * r12)
        up = a * r20 + b * r21 + c * r22
        along_x = size_of(east) >= size_of(south)
        major = select(along_x, east, south)
        minor = select(along_x, south, east)
        inverse = 1.0 / size_of(major)
        t = minor * inverse
        face = select(along_x, 0.0, 2.0) + select(major > 0.0, 0.0, 1.0)
        place = (t + 1.0) * (0.5 * WEDGES_A_FACE)
        place = select(place < WEDGES_A_FACE - 1.0, place, WEDGES_A_FACE - 1.0)
        place = floor_of(select(place > 0.0, place, 0.0))
        first = g * WIDTH
        store(block, PER_MAJOR + first, inverse)
        store(block, T + first, t)
        store(block, SLOPE + first, up * inverse * resolution)
        store(block, FACE + first, face)
        store(block, WEDGE + first, face * float(WEDGES_A_FACE) + place)


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def first_cells(
    nodes: Float32Array,
    width: int,
    height: int,
    stage: RasterStage,
    outers: Float32Array,
    groups: int,
    block: Float64Array,
    at: int,
    out: Float32Array,
    waiting: Float64Array,
    count: int,
) -> int:
    """Take `groups` of rays through their first cells, and answer those that hit or meet only sky.

    Those that need more cells join the `count` waiting; what is rare keeps its `NEAR`. `at`: flat index of the first
    pixel. Returns how many wait.
    """
    columns, rows = float(width - 1), float(height - 1)
    ox, oy = stage.ox, stage.oy
    x_here = min(max(np.floor(ox), 0.0), columns - 1.0)
    y_here = min(max(np.floor(oy), 0.0), rows - 1.0)
    to_sky = stage.last and stage.bend >= 0.0
    for g in range(groups):
        first = g * WIDTH
        near = load(block, NEAR + first)
        s, t, per_major = load(block, SLOPE + first), load(block, T + first), load(block, PER_MAJOR + first)
        range_before = load(out, at + first)
        plain = (range_before == OVER_KNOWN) & (per_major <= 1.0 / PLUMB_SINE)
        sky = plain & (near == MEETS_NOTHING) & (s >= 0.0)
        if not to_sky:
            sky = sky & ~sky
        going = plain & (near >= 0.0)
        hit = going & ~going
        q = s
        if any_of(going):
            face = load(block, FACE + first)
            along_x, backward = face < 2.0, (face == 1.0) | (face == 3.0)
            sign = select(backward, -1.0, 1.0)
            q = sign * (near - select(along_x, ox, oy))
            begun = q > 0.0
            q = select(begun, q, 0.0)
            outer = gather(outers, to_ints(load(block, WEDGE + first)), going)
            m = select(along_x, oy, ox) + t * q
            going = going & (q <= outer) & (m >= 0.0) & (m <= select(along_x, rows, columns))
            major = select(begun, near + select(backward, -1.0, 0.0), select(along_x, x_here, y_here))
            last = select(along_x, rows, columns) - 1.0
            minor = floor_of(m)
            minor = select(minor < last, minor, last)
            cx, cy = select(along_x, sign, t), select(along_x, t, sign)
            x, y = select(along_x, major, minor), select(along_x, minor, major)
            bend = stage.bend * (t * t + 1.0)
            scale = per_major * stage.resolution
            q, x, y, hit, going = through_cells(
                nodes, width, height, stage.ox, stage.oy, stage.oz, cx, cy, s, bend, q, x, y, going, FIRST_STEPS
            )
            if any_of(going):
                place = to_floats(lane_numbers()) + float(at + first)
                store(waiting, _CX + count, compressed(cx, going))
                store(waiting, _CY + count, compressed(cy, going))
                store(waiting, _S + count, compressed(s, going))
                store(waiting, _BEND + count, compressed(bend, going))
                store(waiting, _SCALE + count, compressed(scale, going))
                store(waiting, _PLACE + count, compressed(place, going))
                store(waiting, _Q + count, compressed(q, going))
                store(waiting, _X + count, compressed(x, going))
                store(waiting, _Y + count, compressed(y, going))
                store(waiting, _ROUNDS + count, s - s)
                count += count_of(going)
            q = q * scale
        answered = hit | sky
        if any_of(answered):
            store(out, at + first, select(hit, q, select(sky, np.inf, range_before)))
        store(block, NEAR + first, select(answered | going, ANSWERED, near))
    return count


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def through_cells(
    nodes: Float32Array,
    width: int,
    height: int,
    ox: float,
    oy: float,
    oz: float,
    cx: Any,
    cy: Any,
    s: Any,
    bend: Any,
    q: Any,
    x: Any,
    y: Any,
    going: Any,
    steps: int,
) -> tuple[Any, Any, Any, Any, Any]:
    """Take lanes of rays, which are in cell (x, y) at range q, through up to `steps` cells.

    Returns q, x, y, which have hit, and which are still going; those that are neither have come to a hole, or left.
    """
    columns, rows = float(width - 1), float(height - 1)
    step_x, step_y = select(cx > 0.0, 1.0, -1.0), select(cy > 0.0, 1.0, -1.0)
    ahead_x, ahead_y = select(cx > 0.0, 1.0 - ox, -ox), select(cy > 0.0, 1.0 - oy, -oy)
    # A ray along an axis never comes to the edges beside it.
    never_x, never_y = select(cx == 0.0, np.inf, 0.0), select(cy == 0.0, np.inf, 0.0)
    per_cx, per_cy = select(cx == 0.0, 0.0, 1.0 / cx), select(cy == 0.0, 0.0, 1.0 / cy)
    sag = 0.25 * select(bend > 0.0, bend, 0.0)  # the parabola lies at most sag * dq^2 below its chord
    z = ray_height(oz, s, bend, q)
    hit = going & ~going
    # Height above the surface where a ray has met it, and the way left in that cell; until then one with its root at 0.
    k0, k1, k2, reach = q - q, q - q - 1.0, q - q, q - q
    for _ in range(steps):
        q_x = (x + ahead_x) * per_cx + never_x
        q_y = (y + ahead_y) * per_cy + never_y
        over_x = q_x <= q_y
        q_exit = select(over_x, q_x, q_y)
        q_exit = select(q_exit > q, q_exit, q)
        z_exit = ray_height(oz, s, bend, q_exit)
        dq = q_exit - q
        low = select(z < z_exit, z, z_exit) - sag * dq * dq
        at = to_ints(y * float(width) + x)
        h00, h10 = gather_pair(nodes, at, going)
        h01, h11 = gather_pair(nodes, at + width, going)
        under = going & ~((low > h00) & (low > h10) & (low > h01) & (low > h11))
        if any_of(under):
            b, e, g = surface(h00, h10, h01, h11)
            u, v = ox + cx * q - x, oy + cy * q - y
            f0, f1, a = clearance(z, s, bend, q, cx, cy, h00, b, e, g, u, v)
            below = f0 <= 0.0
            found = under & (below | meets(f0, f1, a, dq))
            hole = under & (g != g)
            # Roots are costly: those of all lanes are taken together at the end.
            clear = found & ~below
            k0, k1, k2, reach = (
                select(clear, f0, k0),
                select(clear, f1, k1),
                select(clear, a, k2),
                select(clear, dq, reach),
            )
            hit = hit | found
            going = going & ~(found | hole)
            if not any_of(going):
                break
        q = select(going, q_exit, q)
        z = select(going, z_exit, z)
        x = x + select(going & over_x, step_x, 0.0)
        y = y + select(going & ~over_x, step_y, 0.0)
        going = going & (x >= 0.0) & (x < columns) & (y >= 0.0) & (y < rows)
    return q + first_root(k0, k1, k2, reach), x, y, hit, going


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def more_cells(
    ground: TerrainRaster,
    nodes: Float32Array,
    width: int,
    height: int,
    stage: RasterStage,
    out: Float32Array,
    waiting: Float64Array,
    count: int,
    leave: int,
) -> int:
    """Take those that wait, `count` of them, through cells until no more than `leave` still do; returns how many."""
    while count > leave:
        kept = 0
        for first in range(0, count, WIDTH):
            present = lane_numbers() < count - first
            cx, cy, s = load(waiting, _CX + first), load(waiting, _CY + first), load(waiting, _S + first)
            bend, rounds = load(waiting, _BEND + first), load(waiting, _ROUNDS + first) + 1.0
            q, x, y = load(waiting, _Q + first), load(waiting, _X + first), load(waiting, _Y + first)
            q, x, y, hit, going = through_cells(
                nodes, width, height, stage.ox, stage.oy, stage.oz, cx, cy, s, bend, q, x, y, present, MORE_STEPS
            )
            going = going & (rounds < float(MOST_ROUNDS))
            store(waiting, _Q + first, q)
            for i in range(min(count - first, WIDTH)):
                if not is_set(going, i):
                    _answer(ground, stage, waiting, first + i, is_set(hit, i), out)
            for field in _UNCHANGED:
                store(waiting, field + kept, compressed(load(waiting, field + first), going))
            for field, value in ((_ROUNDS, rounds), (_Q, q), (_X, x), (_Y, y)):
                store(waiting, field + kept, compressed(value, going))
            kept += count_of(going)
        count = kept
    return count


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def _answer(
    ground: TerrainRaster, stage: RasterStage, waiting: Float64Array, k: int, hit: bool, out: Float32Array
) -> None:
    """Write the range of a ray that waits no more; one that has not hit goes on by the pyramid."""
    q = waiting[_Q + k]
    if not hit:
        cx, cy, s, bend = waiting[_CX + k], waiting[_CY + k], waiting[_S + k], waiting[_BEND + k]
        q = hit_between(ground, stage, cx, cy, s, bend, q, over_raster(stage, cx, cy)[1], OVER_KNOWN, 0)
        q = finished(stage, cx, cy, s, bend, q)
    out[int(waiting[_PLACE + k])] = q * waiting[_SCALE + k] if q >= 0.0 else q
