"""The fast path: an image's columns are swept upwards over the wedge profile, and each hit is found cell by cell.

Going up a column of pixels, rays climb, so that the entry of the profile that a ray needs is a few places after that
of the pixel below: the place is kept as a hint. From the strip that the entry names, a ray goes through single cells,
of which it takes half a dozen on the average; a ray that needs more, or comes to a hole, is handed to the pyramid
(`traversal.hit_from`), which holds the rules for what ends a ray. A ray without an entry meets nothing, and the
terrain is not looked at.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ltm_core.tracing.profile import WEDGES_A_FACE, Wedges
from ltm_core.tracing.traversal import PLUMB_SINE, Floats, Ground, first_hit, height_at, hit_from

_FASTMATH = {"contract", "nsz"}
_TILE = 16
_MOST_CELLS = 24


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH, parallel=True, nogil=True)  # type: ignore[untyped-decorator]
def sweep_image(
    ground: Ground,
    wedges: Wedges,
    ox: float,
    oy: float,
    oz: float,
    rotation: Floats,
    rays: Floats,
    resolution: float,
    bend: float,
    out: NDArray[np.float32],
) -> None:
    """Slant range in metres of an image of rays, into `out` (H, W) float32.

    The origin must stand over the raster, and not in an outer hole.

    Args:
        wedges: profile of the origin.
        ox, oy, oz: origin: column, row, height in metres.
        rotation: (3, 3) float64, ray frame -> (east, north, up).
        rays: (H, W, 3) float64 unit vectors; a NaN one gives NaN.
        resolution: metres a cell; `bend`: 1/m.
    """
    height, width = rays.shape[0], rays.shape[1]
    tiles = (width + _TILE - 1) // _TILE
    grid_bend = bend * resolution * resolution
    for tile in prange(tiles):
        hints = np.zeros(_TILE, np.int64)
        for k in range(height):
            row = height - 1 - k
            for i in range(min(_TILE, width - tile * _TILE)):
                col = tile * _TILE + i
                a, b, c = rays[row, col, 0], rays[row, col, 1], rays[row, col, 2]
                east = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
                south = -(rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c)
                up = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
                if not (east == east and south == south and up == up):
                    out[row, col] = np.nan
                    continue
                along_x = abs(east) >= abs(south)
                major, minor = (east, south) if along_x else (south, east)
                # (cx, cy) has length sqrt(1 + t^2): the slope and the bend of the ray are those for that length.
                per_major = 1.0 / abs(major)
                t = minor * per_major
                forward = major > 0.0
                sign = 1.0 if forward else -1.0
                s = up * per_major * resolution
                bend_here = grid_bend * (1.0 + t * t)
                if math.sqrt(east * east + south * south) < PLUMB_SINE:
                    out[row, col] = np.inf if up > 0.0 else oz - height_at(ground, ox, oy)
                    continue
                cx, cy = (sign, t) if along_x else (t, sign)
                face = (0 if along_x else 2) + (0 if forward else 1)
                wedge = face * WEDGES_A_FACE + min(int((t + 1.0) * (0.5 * WEDGES_A_FACE)), WEDGES_A_FACE - 1)
                count = wedges.entries[wedge]
                if count < 0:
                    q = first_hit(ground, ox, oy, oz, cx, cy, s, bend_here)
                else:
                    place = first_reaching(wedges.tangent, wedges.start[wedge], count, hints[i], s)
                    hints[i] = place
                    if place == count:
                        q = beyond(ground, ox, oy, cx, cy, s, bend_here)
                    else:
                        node = wedges.node[wedges.start[wedge] + place]
                        q = max(sign * (node - (ox if along_x else oy)), 0.0)
                        if q > wedges.outer[wedge]:
                            q = first_hit(ground, ox, oy, oz, cx, cy, s, bend_here)
                        else:
                            q = cell_hit(ground, ox, oy, oz, cx, cy, s, bend_here, q, node, along_x, forward, t)
                out[row, col] = q * resolution * per_major


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
def beyond(ground: Ground, ox: float, oy: float, cx: float, cy: float, s: float, bend: float) -> float:
    """What a ray from over the raster that meets nothing gives: +inf where it leaves climbing, else NaN."""
    if s >= 0.0 and bend >= 0.0:
        return np.inf
    q_x = ((ground.width - 1 if cx > 0.0 else 0) - ox) / cx if cx != 0.0 else np.inf
    q_y = ((ground.height - 1 if cy > 0.0 else 0) - oy) / cy if cy != 0.0 else np.inf
    return np.inf if s + 2.0 * bend * min(q_x, q_y) >= 0.0 else np.nan


@njit(cache=True, error_model="numpy", fastmath=_FASTMATH)  # type: ignore[untyped-decorator]
def cell_hit(
    ground: Ground,
    ox: float,
    oy: float,
    oz: float,
    cx: float,
    cy: float,
    s: float,
    bend: float,
    q: float,
    node: int,
    along_x: bool,
    forward: bool,
    t: float,
) -> float:
    """First hit of a ray that meets nothing before q, where it crosses node line `node` of its major axis."""
    nodes = ground.nodes
    o_major, o_minor = (ox, oy) if along_x else (oy, ox)
    major_stride, minor_stride = (1, ground.width) if along_x else (ground.width, 1)
    n_major, n_minor = (ground.width - 1, ground.height - 1) if along_x else (ground.height - 1, ground.width - 1)
    sign = 1.0 if forward else -1.0
    step = 1 if forward else -1
    begin = q
    cell = node if forward else node - 1
    m = o_minor + t * q
    if m < 0.0 or m > n_minor:
        return beyond(ground, ox, oy, cx, cy, s, bend)
    lane = min(int(m), n_minor - 1)
    per_t = 1.0 / t
    z = oz + q * (s + bend * q)
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
            return hit_from(ground, ox, oy, oz, cx, cy, s, bend, begin, True, 0)
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
        z = oz + q * (s + bend * q)
        if q_major <= q_minor:
            cell += step
            if cell < 0 or cell >= n_major:
                return beyond(ground, ox, oy, cx, cy, s, bend)
        else:
            lane += 1 if ahead else -1
            if lane < 0 or lane >= n_minor:
                return beyond(ground, ox, oy, cx, cy, s, bend)
    return hit_from(ground, ox, oy, oz, cx, cy, s, bend, q, True, 2)
