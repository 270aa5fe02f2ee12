"""A ray through single cells of the raster, one after the other, to its first hit."""

from __future__ import annotations

import numpy as np
from numba import njit

from ltm_core.tracing.cell_intersection import FASTMATH, clearance, first_root, meets, ray_height, surface
from ltm_core.types import Float32Array

HIT, LEFT, OPEN = 0, 1, 2
"""How single cells end: at the ground, at the raster's edge, or at a hole or after many of them."""
_MOST_CELLS = 48


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def cell_hit(
    nodes: Float32Array,
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
    z = ray_height(oz, s, bend, q)
    q_major = sign * (cell + far_major - o_major)
    q_minor = (lane + far_minor - o_minor) * per_t if t != 0.0 else np.inf
    for _ in range(_MOST_CELLS):
        q_exit = max(min(q_major, q_minor), q)
        z_exit = ray_height(oz, s, bend, q_exit)
        dq = q_exit - q
        low = min(z, z_exit) - sag * dq * dq
        h00 = float(nodes[np.uint64(at)])
        h01 = float(nodes[np.uint64(at + minor_stride)])
        h10 = float(nodes[np.uint64(at + major_stride)])
        h11 = float(nodes[np.uint64(at + major_stride + minor_stride)])
        if not (low > h00 and low > h01 and low > h10 and low > h11):
            b, e, g = surface(h00, h10, h01, h11)
            if g != g:
                return q, OPEN
            u = o_major + sign * q - cell
            v = o_minor + t * q - lane
            f0, f1, a = clearance(z, s, bend, q, sign, t, h00, b, e, g, u, v)
            if f0 <= 0.0:
                return q, HIT
            if meets(f0, f1, a, dq):
                return q + first_root(f0, f1, a, dq), HIT
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
