"""Intersect a curved ray with the bilinear surface of single DEM cells, one after the other.

Grid units, as everywhere in the kernels (see `pyramid_traversal`)."""

import math

import numpy as np

from ltm_core.base.kernels import helper
from ltm_core.base.types import Float32Array

# Contracting to FMA is safe; nnan and ninf would break the NaN and infinity that mean hole and sky.
FASTMATH = {"contract", "nsz"}


@helper(fastmath=FASTMATH)
def ray_height(oz: float, s: float, bend: float, q: float) -> float:
    """Return the height of a ray at range q: z(q) = oz + s q + bend q^2."""
    return oz + q * (s + bend * q)


@helper(fastmath=FASTMATH)
def surface(h00: float, h10: float, h01: float, h11: float) -> tuple[float, float, float]:
    """Return the coefficients b, e, g of the surface h00 + b u + e v + g u v between four corners, hxy at u = x, v =
    y."""
    b = h10 - h00
    return b, h01 - h00, h11 - h01 - b


@helper(fastmath=FASTMATH)
def clearance(
    z: float,
    s: float,
    bend: float,
    q: float,
    cx: float,
    cy: float,
    h00: float,
    b: float,
    e: float,
    g: float,
    u: float,
    v: float,
) -> tuple[float, float, float]:
    """Return the height of a ray above a cell's surface from the range q on, where it is at (u, v): f0 + f1 t + a
    t^2."""
    f0 = z - (h00 + b * u + v * (e + g * u))
    f1 = s + 2.0 * bend * q - (b + g * v) * cx - (e + g * u) * cy
    return f0, f1, bend - g * cx * cy


@helper(fastmath=FASTMATH)
def meets(f0: float, f1: float, a: float, dq: float) -> bool:
    """Return whether f0 + f1 t + a t^2, positive at 0, has a root up to dq: it is negative there, or dips in
    between."""
    dips = (f1 < 0.0) & (f1 + 2.0 * a * dq > 0.0) & (f1 * f1 >= 4.0 * a * f0)
    return dips | (f0 + dq * (f1 + a * dq) <= 0.0)


@helper(fastmath=FASTMATH)
def first_root(f0: float, f1: float, a: float, dq: float) -> float:
    """Return the first root of f0 + f1 t + a t^2, at most dq, if any: the formula that does not cancel (Press et al.,
    Numerical Recipes, 3rd ed., 5.6)."""
    discriminant = f1 * f1 - 4.0 * a * f0
    root = 2.0 * f0 / (math.sqrt(discriminant if discriminant > 0.0 else 0.0) - f1)
    return root if root < dq else dq


HIT, LEFT, OPEN = 0, 1, 2
"""Result for a cell: the ground was hit, the raster's edge was reached, or the ray is open (a hole, or many cells
without a hit)."""
_MOST_CELLS = 48


@helper(fastmath=FASTMATH)
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
    """Return the range of the first hit of a ray that meets nothing before `q`, where it is in strip `cell` of its
    major axis, and: HIT; LEFT, it leaves the raster without one; or OPEN, the pyramid must continue from there."""
    # Where the ray enters the strip, and how far it is to the next cell on either axis.
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
        # Does the ray meet the surface of this cell?
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
        # On to the next cell.
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
