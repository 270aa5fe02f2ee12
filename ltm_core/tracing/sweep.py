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
_MEETS_NOTHING = -1
_BY_PYRAMID = -2


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
                along_x, forward, t = faces[i] < 2, (faces[i] & 1) == 0, ts[i]
                s = slopes[i] * resolution
                sign = 1.0 if forward else -1.0
                cx, cy = (sign, t) if along_x else (t, sign)
                bend = stage.bend * (1.0 + t * t)
                q = state
                if near[i] != _MEETS_NOTHING or state != OVER_KNOWN:
                    start = 0.0
                    if stage.part == AFTER:
                        start = stretch(stage, cx, cy)[0]
                    begin = start
                    if near[i] >= 0:
                        begin = max(begin, sign * (near[i] - (stage.ox if along_x else stage.oy)))
                    if near[i] == _BY_PYRAMID or state != OVER_KNOWN or begin > wedges.outer[wedge[i]]:
                        end = over_raster(stage, cx, cy)[1]
                        q = hit_between(ground, stage, cx, cy, s, bend, start, end, state, START_LEVEL)
                    else:
                        line = near[i] if begin > start else -1
                        q = cell_hit(ground, stage, cx, cy, s, bend, begin, line, along_x, forward, t)
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
        prefetch(ground.nodes, at)
        prefetch(ground.nodes, at + ground.width if face == 2 else at - ground.width)


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
    ground: Ground,
    stage: Stage,
    cx: float,
    cy: float,
    s: float,
    bend: float,
    begin: float,
    node: int,
    along_x: bool,
    forward: bool,
    t: float,
) -> float:
    """First hit of a ray that meets nothing before `begin`, where it crosses node line `node` of its major axis, or
    lies within a strip where `node` is -1; its state where it leaves the raster without one.
    """
    nodes = ground.nodes
    o_major, o_minor = (stage.ox, stage.oy) if along_x else (stage.oy, stage.ox)
    major_stride, minor_stride = (1, ground.width) if along_x else (ground.width, 1)
    n_major, n_minor = (ground.width - 1, ground.height - 1) if along_x else (ground.height - 1, ground.width - 1)
    sign = 1.0 if forward else -1.0
    step = 1 if forward else -1
    q = begin
    cell = node if forward else node - 1
    if node < 0:
        cell = min(max(math.floor(o_major + sign * q), 0), n_major - 1)
    m = o_minor + t * q
    if m < 0.0 or m > n_minor:
        return OVER_KNOWN
    lane = min(int(m), n_minor - 1)
    per_t = 1.0 / t
    z = stage.oz + q * (s + bend * q)
    ahead = 1 if t > 0.0 else 0
    for _ in range(_MOST_CELLS):
        q_major = sign * ((cell + 1 if forward else cell) - o_major)
        q_minor = (lane + ahead - o_minor) * per_t if t != 0.0 else np.inf
        q_exit = max(min(q_major, q_minor), q)
        at = cell * major_stride + lane * minor_stride
        h00 = float(nodes[np.uint64(at)])
        h01 = float(nodes[np.uint64(at + minor_stride)])
        h10 = float(nodes[np.uint64(at + major_stride)])
        h11 = float(nodes[np.uint64(at + major_stride + minor_stride)])
        b = h10 - h00
        e = h01 - h00
        g = h11 - h01 - b
        if g != g:
            return hit_between(ground, stage, cx, cy, s, bend, begin, over_raster(stage, cx, cy)[1], OVER_KNOWN, 0)
        u = o_major + sign * q - cell
        v = o_minor + t * q - lane
        f0 = z - (h00 + b * u + v * (e + g * u))
        if f0 <= 0.0:
            return q
        dq = q_exit - q
        f1 = s + 2.0 * bend * q - (b + g * v) * sign - (e + g * u) * t
        a = bend - g * sign * t
        if f0 + dq * (f1 + a * dq) <= 0.0 or (f1 < 0.0 and f1 + 2.0 * a * dq > 0.0 and f1 * f1 >= 4.0 * a * f0):
            root = 2.0 * f0 / (-f1 + math.sqrt(max(f1 * f1 - 4.0 * a * f0, 0.0)))
            return q + min(root, dq)
        q = q_exit
        z = stage.oz + q * (s + bend * q)
        if q_major <= q_minor:
            cell += step
            if cell < 0 or cell >= n_major:
                return OVER_KNOWN
        else:
            lane += 1 if ahead else -1
            if lane < 0 or lane >= n_minor:
                return OVER_KNOWN
    return hit_between(ground, stage, cx, cy, s, bend, q, over_raster(stage, cx, cy)[1], OVER_KNOWN, 2)
