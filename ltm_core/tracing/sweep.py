"""The fast path: an image's columns are swept upwards over the wedge profile, and each hit is found cell by cell.

Going up a column of pixels, rays climb, so that the entry of the profile that a ray needs is a few places after that
of the pixel below: the place is kept as a hint. From the strip that the entry names, a ray goes through single cells,
of which it takes half a dozen on the average; a ray that needs more, or comes to a hole, is handed to the pyramid
(`traversal.hit_between`), which holds the rules for what ends a ray. A ray without an entry meets nothing, and the
terrain is not looked at.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ltm_core.tracing.prefetch import prefetch
from ltm_core.tracing.profile import WEDGES_A_FACE, Wedges
from ltm_core.tracing.traversal import (
    AFTER,
    OVER_KNOWN,
    PLUMB_SINE,
    START_LEVEL,
    Floats,
    Ground,
    Stage,
    finished,
    height_at,
    hit_between,
    over_raster,
    stretch,
)

_FASTMATH = {"contract", "nsz"}
_TILE = 16
_MOST_CELLS = 48
_ROWS_AHEAD = 4
"""Rows fetched ahead of a ray that goes from row to row, each in memory of its own."""
_MEETS_NOTHING = -1
_BY_PYRAMID = -2
HIT, LEFT, OPEN = 0, 1, 2
"""How single cells end: at the ground, at the raster's edge, or at a hole or after many of them."""


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH, parallel=True, nogil=True)  # type: ignore[untyped-decorator]
def sweep_image(
    ground: Ground, stage: Stage, wedges: Wedges, rotation: Floats, rays: Floats, out: NDArray[np.float32]
) -> None:
    """Take an image of rays through one stage.

    The camera must stand over the raster or the next finer one, and not in an outer hole.

    Args:
        wedges: profile of the camera's position for this stage.
        rotation: (3, 3) float64, ray frame -> (east, north, up).
        rays: (H, W, 3) float64 unit vectors; a NaN one gives NaN.
        out: (H, W) float32, slant ranges in metres, or the states of rays that have met nothing: on entry before this
            stage, on return after it.
    """
    height, width = rays.shape[0], rays.shape[1]
    rows, columns = ground.height - 1, ground.width - 1
    resolution = stage.resolution
    tiles = (width + _TILE - 1) // _TILE
    for tile in prange(tiles):
        first = tile * _TILE
        lanes = min(_TILE, width - first)
        hints = np.zeros(_TILE, np.int64)
        near = np.empty(_TILE, np.int64)
        majors, ts, slopes = np.empty(_TILE), np.empty(_TILE), np.empty(_TILE)
        faces = np.empty(_TILE, np.int32)
        wedge = np.empty(_TILE, np.int32)
        for k in range(height):
            row = height - 1 - k
            _to_grid(rays[row, first : first + lanes], rotation, majors, ts, slopes, faces, wedge)
            for i in range(lanes):
                s = slopes[i] * resolution
                if not (s <= wedges.highest[wedge[i]]):
                    # Whether it is over known ground when it leaves matters only where more ground may come.
                    near[i] = _MEETS_NOTHING if stage.last or wedges.outer[wedge[i]] == np.inf else _BY_PYRAMID
                    continue
                if wedges.entries[wedge[i]] < 0:
                    near[i] = _BY_PYRAMID
                    continue
                place = first_reaching(wedges.tangent, wedges.start[wedge[i]], wedges.entries[wedge[i]], hints[i], s)
                hints[i] = place
                node = np.int64(wedges.node[wedges.start[wedge[i]] + place])
                near[i] = node
                _prefetch_start(ground, stage, faces[i], ts[i], node)
            for i in range(lanes):
                state = float(out[row, first + i])
                if not state < 0.0:
                    continue
                per_major = majors[i]
                if not (per_major <= 1.0 / PLUMB_SINE):
                    out[row, first + i] = straight(ground, stage, rays[row, first + i], rotation)
                    continue
                along_x, t = faces[i] < 2, ts[i]
                s = slopes[i] * resolution
                sign = 1.0 if (faces[i] & 1) == 0 else -1.0
                cx, cy = (sign, t) if along_x else (t, sign)
                bend = stage.bend * (1.0 + t * t)
                q = state
                if near[i] != _MEETS_NOTHING or state != OVER_KNOWN:
                    start = stretch(stage, cx, cy)[0] if stage.part == AFTER else 0.0
                    o_major, o_minor = (stage.ox, stage.oy) if along_x else (stage.oy, stage.ox)
                    how, level = OPEN, START_LEVEL
                    begin = start
                    if near[i] >= 0:
                        begin = max(start, sign * (near[i] - o_major))
                        if state != OVER_KNOWN or begin > wedges.outer[wedge[i]]:
                            begin = start
                        else:
                            n_major, n_minor = (columns, rows) if along_x else (rows, columns)
                            along, across = (1, ground.width) if along_x else (ground.width, 1)
                            cell = float(near[i] if sign > 0.0 else near[i] - 1)
                            if begin == start:
                                cell = min(max(math.floor(o_major + sign * start), 0.0), n_major - 1.0)
                            begin, how = cell_hit(
                                ground.nodes,
                                o_major,
                                o_minor,
                                stage.oz,
                                s,
                                bend,
                                t,
                                sign,
                                begin,
                                cell,
                                n_major,
                                n_minor,
                                along,
                                across,
                            )
                            level = 0
                    if how == OPEN:
                        end = over_raster(stage, cx, cy)[1]
                        q = hit_between(ground, stage, cx, cy, s, bend, begin, end, state, level)
                    elif how == HIT:
                        q = begin
                q = finished(stage, cx, cy, s, bend, q)
                out[row, first + i] = q * resolution * per_major if q >= 0.0 else q


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)  # type: ignore[untyped-decorator]
def straight(ground: Ground, stage: Stage, ray: Floats, rotation: Floats) -> float:
    """Range of a plumb ray; NaN of one that is none."""
    up = rotation[2, 0] * ray[0] + rotation[2, 1] * ray[1] + rotation[2, 2] * ray[2]
    if up > 0.0:
        return np.inf
    return stage.oz - height_at(ground, stage.ox, stage.oy) if up < 0.0 else np.nan


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)  # type: ignore[untyped-decorator]
def _to_grid(
    rays: Floats,
    rotation: Floats,
    per_major: Floats,
    ts: Floats,
    slopes: Floats,
    faces: NDArray[np.int32],
    wedges: NDArray[np.int32],
) -> None:
    """Turn rays into the grid: 1 / |major|, t, slope up / |major|, face and wedge; a loop that vectorizes."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = -rotation[1, 0], -rotation[1, 1], -rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for i in range(rays.shape[0]):
        a, b, c = rays[i, 0], rays[i, 1], rays[i, 2]
        east = r00 * a + r01 * b + r02 * c
        south = r10 * a + r11 * b + r12 * c
        up = r20 * a + r21 * b + r22 * c
        along_x = abs(east) >= abs(south)
        major = east if along_x else south
        minor = south if along_x else east
        inverse = 1.0 / abs(major)
        t = minor * inverse
        face = (np.int32(0) if along_x else np.int32(2)) + (np.int32(0) if major > 0.0 else np.int32(1))
        place = (t + 1.0) * (0.5 * WEDGES_A_FACE)
        place = place if place < WEDGES_A_FACE - 1 else WEDGES_A_FACE - 1.0
        place = place if place > 0.0 else 0.0
        per_major[i] = inverse
        ts[i] = t
        slopes[i] = up * inverse
        faces[i] = face
        wedges[i] = face * np.int32(WEDGES_A_FACE) + np.int32(place)


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def _prefetch_start(ground: Ground, stage: Stage, face: int, t: float, node: int) -> None:
    if face < 2:
        at = int(stage.oy + t * abs(node - stage.ox)) * ground.width + node
        prefetch(ground.nodes, at)
        prefetch(ground.nodes, at + ground.width)
    else:
        at = node * ground.width + int(stage.ox + t * abs(node - stage.oy))
        row = ground.width if face == 2 else -ground.width
        for k in range(_ROWS_AHEAD):
            prefetch(ground.nodes, at + k * row)


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def first_reaching(tangents: NDArray[np.float32], start: int, count: int, hint: int, slope: float) -> int:
    """Place of the first of `count` increasing tangents (from `start`) that is at least `slope`; `count` where none is.

    The search widens from `hint` by doubling steps.
    """
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


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)  # type: ignore[untyped-decorator]
def cell_hit(
    nodes: NDArray[np.float32],
    o_major: float,
    o_minor: float,
    oz: float,
    s: float,
    bend: float,
    t: float,
    sign: float,
    q: float,
    cell: float,
    n_major: int,
    n_minor: int,
    major_stride: int,
    minor_stride: int,
) -> tuple[float, int]:
    """First hit of a ray that meets nothing before `q`, where it is in strip `cell` of its major axis.

    Returns the range and: HIT; LEFT, it leaves the raster without one; or OPEN, the pyramid must go on from there.
    """
    m = o_minor + t * q
    if m < 0.0 or m > n_minor:
        return q, LEFT
    lane = float(min(int(m), n_minor - 1))
    at = int(cell) * major_stride + int(lane) * minor_stride
    per_t = 1.0 / t if t != 0.0 else np.inf
    side = 1.0 if t > 0.0 else -1.0
    far_major = 1.0 if sign > 0.0 else 0.0
    far_minor = 1.0 if t > 0.0 else 0.0
    next_major = major_stride if sign > 0.0 else -major_stride
    next_minor = minor_stride if t > 0.0 else -minor_stride
    sag = 0.25 * max(bend, 0.0)
    z = oz + q * (s + bend * q)
    q_major = sign * (cell + far_major - o_major)
    q_minor = (lane + far_minor - o_minor) * per_t if t != 0.0 else np.inf
    for _ in range(_MOST_CELLS):
        q_exit = max(min(q_major, q_minor), q)
        z_exit = oz + q_exit * (s + bend * q_exit)
        dq = q_exit - q
        low = min(z, z_exit) - sag * dq * dq
        h00 = float(nodes[np.uint64(at)])
        h01 = float(nodes[np.uint64(at + minor_stride)])
        h10 = float(nodes[np.uint64(at + major_stride)])
        h11 = float(nodes[np.uint64(at + major_stride + minor_stride)])
        if not (low > h00 and low > h01 and low > h10 and low > h11):
            b = h10 - h00
            e = h01 - h00
            g = h11 - h01 - b
            if g != g:
                return q, OPEN
            u = o_major + sign * q - cell
            v = o_minor + t * q - lane
            f0 = z - (h00 + b * u + v * (e + g * u))
            if f0 <= 0.0:
                return q, HIT
            f1 = s + 2.0 * bend * q - (b + g * v) * sign - (e + g * u) * t
            a = bend - g * sign * t
            if f0 + dq * (f1 + a * dq) <= 0.0 or (f1 < 0.0 and f1 + 2.0 * a * dq > 0.0 and f1 * f1 >= 4.0 * a * f0):
                root = 2.0 * f0 / (-f1 + math.sqrt(max(f1 * f1 - 4.0 * a * f0, 0.0)))
                return q + min(root, dq), HIT
        q = q_exit
        z = z_exit
        if q_major <= q_minor:
            cell += sign
            at += next_major
            if cell < 0.0 or cell >= n_major:
                return q, LEFT
            q_major = sign * (cell + far_major - o_major)
        else:
            lane += side
            at += next_minor
            if lane < 0.0 or lane >= n_minor:
                return q, LEFT
            q_minor = (lane + far_minor - o_minor) * per_t
    return q, OPEN
