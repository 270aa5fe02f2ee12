"""Trace a whole image column by column, from the bottom up over the horizon profile.

Up a column of pixels rays climb, so the entry of the profile that a ray needs is a few places after that of the pixel
below. From the strip that the entry names, a ray goes through single cells; one that needs more than a few, or comes
to a hole, is handed to the pyramid (`pyramid_traversal.hit_between`). A ray without an entry meets nothing.

A block of neighbouring columns is one flat float64 array, in which each field has `COLUMNS` places."""

import math

import numpy as np

from ltm_core.base.kernels import helper, in_parallel, kernel
from ltm_core.base.types import Float32Array, Float64Array, Int32Array, Int64Array
from ltm_core.tracing.cell_intersection import FASTMATH, HIT, LEFT, cell_hit
from ltm_core.tracing.horizon_profile import WEDGES_A_FACE, Wedges
from ltm_core.tracing.pyramid_traversal import (
    AFTER,
    OVER_KNOWN,
    PLUMB_SINE,
    START_LEVEL,
    RasterStage,
    TerrainRaster,
    crossing,
    finished,
    height_at,
    hit_between,
    stretch,
)

COLUMNS = 64
PER_MAJOR, T, SLOPE, FACE, WEDGE, HINT, NEAR, BEGIN = range(0, 8 * COLUMNS, COLUMNS)
"""1 / |major| of the unit ray; t; slope in metres per major cell; face and wedge; place of the entry of the row below
within its wedge; node line at or after which the ray's entry begins; range from which the pyramid continues."""
MEETS_NOTHING, BY_PYRAMID, ON_FROM_CELL = -1.0, -2.0, -3.0


def sweep_image(
    ground: TerrainRaster,
    stage: RasterStage,
    wedges: Wedges,
    rotation: Float64Array,
    rays: Float64Array,
    out: Float32Array,
) -> None:
    """Take an image of rays through one stage. The camera must stand over the raster or the next finer one, and in no
    outer hole.

    `wedges`: profile of the camera's position for this stage. `rotation`: (3, 3) ray frame -> (east, north, up).
    `rays`: (H, W, 3) unit vectors; NaN gives NaN. `out`: (H, W) float32, slant ranges in metres, or the states of rays
    that have met nothing, before this stage on entry, after it on return."""
    height, width = rays.shape[:2]
    flat_rays, flat_out = rays.reshape(-1), out.reshape(-1)

    def sweep(first: int, end: int) -> None:
        for column in range(first * COLUMNS, min(end * COLUMNS, width), COLUMNS):
            count = min(COLUMNS, width - column)
            block = np.zeros(8 * COLUMNS)
            _sweep_tile(ground, stage, wedges, rotation, flat_rays, flat_out, block, width, height, column, count)

    in_parallel(sweep, (width + COLUMNS - 1) // COLUMNS)


@kernel(fastmath=FASTMATH, nogil=True)
def _sweep_tile(
    ground: TerrainRaster,
    stage: RasterStage,
    wedges: Wedges,
    rotation: Float64Array,
    rays: Float64Array,
    out: Float32Array,
    block: Float64Array,
    width: int,
    height: int,
    first: int,
    count: int,
) -> None:
    """Sweep `count` columns from `first` on; rays and out are flat, `block` is new."""
    # An array that is read out of a tuple is counted as a reference, by all threads in one place: not in the loop.
    nodes, n_x, n_y = ground.nodes, ground.width, ground.height
    highest, entries, starts = wedges.highest, wedges.entries, wedges.start
    tangents, strips = wedges.tangent, wedges.node
    for k in range(height):
        at = (height - 1 - k) * width + first
        turn(rays, 3 * at, count, rotation, stage.resolution, block)
        left = count
        if enter(highest, entries, starts, tangents, strips, count, block):
            left = through_cells(nodes, n_x, n_y, stage, count, block, at, out)
        if left:
            by_pyramid(ground, stage, count, block, at, out)


@helper(fastmath=FASTMATH)
def turn(
    rays: Float64Array, at: int, count: int, rotation: Float64Array, resolution: float, block: Float64Array
) -> None:
    """Turn the first `count` rays of a block into the grid; they lie flat in `rays`, that of column 0 at index `at`."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = -rotation[1, 0], -rotation[1, 1], -rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for i in range(count):
        a, b, c = rays[at + 3 * i], rays[at + 3 * i + 1], rays[at + 3 * i + 2]
        east = r00 * a + r01 * b + r02 * c
        south = r10 * a + r11 * b + r12 * c
        up = r20 * a + r21 * b + r22 * c
        along_x = abs(east) >= abs(south)
        major = east if along_x else south
        minor = south if along_x else east
        inverse = 1.0 / abs(major)
        t = minor * inverse
        face = (0.0 if along_x else 2.0) + (0.0 if major > 0.0 else 1.0)
        place = (t + 1.0) * (0.5 * WEDGES_A_FACE)
        place = place if place < WEDGES_A_FACE - 1 else WEDGES_A_FACE - 1.0
        place = place if place > 0.0 else 0.0
        block[PER_MAJOR + i] = inverse
        block[T + i] = t
        block[SLOPE + i] = up * inverse * resolution
        block[FACE + i] = face
        block[WEDGE + i] = face * WEDGES_A_FACE + math.floor(place)


@helper()
def enter(
    highest: Float32Array,
    entries: Int32Array,
    starts: Int64Array,
    tangents: Float32Array,
    strips: Int32Array,
    count: int,
    block: Float64Array,
) -> int:
    """Find the entries of a block's rays, in the fields of `Wedges`; returns how many have one."""
    found = 0
    for i in range(count):
        wedge, s = int(block[WEDGE + i]), block[SLOPE + i]
        if not (s <= highest[wedge]):
            block[NEAR + i] = MEETS_NOTHING
        elif entries[wedge] <= 0:
            block[NEAR + i] = BY_PYRAMID
        else:
            place = first_reaching(tangents, starts[wedge], entries[wedge], int(block[HINT + i]), s)
            block[HINT + i] = place
            block[NEAR + i] = strips[starts[wedge] + place]
            found += 1
    return found


@helper(fastmath=FASTMATH)
def through_cells(
    nodes: Float32Array,
    width: int,
    height: int,
    stage: RasterStage,
    count: int,
    block: Float64Array,
    at: int,
    out: Float32Array,
) -> int:
    """Compute those of a block's rays that an entry and single cells decide; return the number left for `by_pyramid`.
    `at`: flat index of the first pixel."""
    columns, rows = width - 1, height - 1
    ox, oy, oz, plain_bend, resolution = stage.ox, stage.oy, stage.oz, stage.bend, stage.resolution
    after = stage.part == AFTER
    left = 0
    for i in range(count):
        near, per_major = block[NEAR + i], block[PER_MAJOR + i]
        if not out[at + i] < 0.0:
            continue
        if not (near >= 0.0 and per_major <= 1.0 / PLUMB_SINE):
            left += 1
            continue
        s, t, face = block[SLOPE + i], block[T + i], int(block[FACE + i])
        along_x = face < 2
        sign = 1.0 if (face & 1) == 0 else -1.0
        start = 0.0
        if after:
            cx, cy = (sign, t) if along_x else (t, sign)
            start = stretch(stage, cx, cy)[0]
        o_major, o_minor = (ox, oy) if along_x else (oy, ox)
        n_major, n_minor = (columns, rows) if along_x else (rows, columns)
        along, over = (1, width) if along_x else (width, 1)
        begin = max(start, sign * (near - o_major))
        cell = near if sign > 0.0 else near - 1.0
        if begin == start:
            cell = min(max(math.floor(o_major + sign * start), 0.0), n_major - 1.0)
        bend = plain_bend * (1.0 + t * t)
        q, how = cell_hit(nodes, o_major, o_minor, oz, s, bend, t, sign, begin, cell, n_major, n_minor, along, over)
        if how == HIT:
            out[at + i] = q * resolution * per_major
        else:
            block[NEAR + i], block[BEGIN + i] = (MEETS_NOTHING if how == LEFT else ON_FROM_CELL), q
            left += 1
    return left


@helper(fastmath=FASTMATH)
def by_pyramid(
    ground: TerrainRaster, stage: RasterStage, count: int, block: Float64Array, at: int, out: Float32Array
) -> None:
    """Compute a block's remaining rays; `at`: flat index of the first pixel."""
    last, oz, top, resolution = stage.last, stage.oz, stage.highest, stage.resolution
    # No ray leaves the raster after `farthest`, and one from a camera over it none before `nearest`.
    west, north, east, south = stage.window
    farthest = max(abs(east), abs(west)) + max(abs(south), abs(north))
    nearest = max(min(min(east, -west), min(south, -north)), 0.0)
    for i in range(count):
        near, q = block[NEAR + i], float(out[at + i])
        if not q < 0.0:
            continue
        s, t, per_major, face = block[SLOPE + i], block[T + i], block[PER_MAJOR + i], int(block[FACE + i])
        if not (per_major <= 1.0 / PLUMB_SINE):
            out[at + i] = straight(ground, stage, s)
            continue
        sign = 1.0 if (face & 1) == 0 else -1.0
        cx, cy = (sign, t) if face < 2 else (t, sign)
        bend = stage.bend * (1.0 + t * t)
        if near != MEETS_NOTHING:
            level, begin = (0, block[BEGIN + i]) if near == ON_FROM_CELL else (START_LEVEL, 0.0)
            if near == BY_PYRAMID and stage.part == AFTER:
                begin = stretch(stage, cx, cy)[0]
            end = crossing(stage.window, cx, cy)[1]
            q = hit_between(ground, stage, cx, cy, s, bend, begin, end, q, level)
        if last and q < 0.0:
            # What most rays end with needs no call, to which all of a stage would be handed for each pixel.
            if s >= 0.0 and q == OVER_KNOWN and bend >= 0.0 and oz + nearest * (s + bend * nearest) > top:
                q = np.inf
            elif bend >= 0.0 and s + 2.0 * bend * farthest < 0.0:
                q = np.nan
            else:
                q = finished(stage, cx, cy, s, bend, q)
        out[at + i] = q * resolution * per_major if q >= 0.0 else q


@helper(fastmath=FASTMATH)
def straight(ground: TerrainRaster, stage: RasterStage, slope: float) -> float:
    """Return the range of a vertical ray, by the sign of its slope; NaN for other rays."""
    if slope > 0.0:
        return np.inf
    return stage.oz - height_at(ground, stage.ox, stage.oy) if slope < 0.0 else np.nan


@helper()
def first_reaching(tangents: Float32Array, start: int, count: int, hint: int, slope: float) -> int:
    """Return the place of the first of `count` increasing tangents (from `start`) that is at least `slope`; `count` if
    none is. The search widens from `hint` by doubling steps."""
    low, high = 0, count  # tangents before `low` are less, those from `high` on are not
    place = min(hint, count)
    step = 1
    if place < count and tangents[start + place] < slope:
        low = place + 1
        place += 1
        while place < count and tangents[start + place] < slope:
            low = place + 1
            step *= 2
            place += step
        high = min(place, count)
    else:
        high = place
        place -= 1
        while place >= 0 and tangents[start + place] >= slope:
            high = place
            step *= 2
            place -= step
        low = max(place + 1, 0)
    while low < high:
        middle = (low + high) >> 1
        if tangents[start + middle] < slope:
            low = middle + 1
        else:
            high = middle
    return low
