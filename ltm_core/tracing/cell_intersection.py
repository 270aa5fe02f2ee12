"""Intersection of a curved ray with the bilinear surface of one DEM cell.

Grid units, as everywhere in the kernels (see `pyramid_traversal`).
"""

from __future__ import annotations

import math

from numba import njit

# Contracting to FMA is safe; nnan and ninf would break the NaN and infinity that mean hole and sky.
FASTMATH = {"contract", "nsz"}


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def ray_height(oz: float, s: float, bend: float, q: float) -> float:
    """Height of a ray at range q: z(q) = oz + s q + bend q^2."""
    return oz + q * (s + bend * q)


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def surface(h00: float, h10: float, h01: float, h11: float) -> tuple[float, float, float]:
    """Coefficients b, e, g of the surface h00 + b u + e v + g u v between four corners, hxy at u = x, v = y."""
    b = h10 - h00
    return b, h01 - h00, h11 - h01 - b


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
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
    """Height of a ray above a cell's surface from the range q on, where it is at (u, v): f0 + f1 t + a t^2."""
    f0 = z - (h00 + b * u + v * (e + g * u))
    f1 = s + 2.0 * bend * q - (b + g * v) * cx - (e + g * u) * cy
    return f0, f1, bend - g * cx * cy


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def meets(f0: float, f1: float, a: float, dq: float) -> bool:
    """Whether f0 + f1 t + a t^2, positive at 0, has a root up to dq: it is negative there, or dips in between."""
    dips = (f1 < 0.0) & (f1 + 2.0 * a * dq > 0.0) & (f1 * f1 >= 4.0 * a * f0)
    return dips | (f0 + dq * (f1 + a * dq) <= 0.0)


@njit(cache=True, error_model="numpy", fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def first_root(f0: float, f1: float, a: float, dq: float) -> float:
    """The first root of f0 + f1 t + a t^2, at most dq, where there is one: the formula that does not cancel.

    Press et al., Numerical Recipes, 3rd ed., 5.6.
    """
    discriminant = f1 * f1 - 4.0 * a * f0
    root = 2.0 * f0 / (math.sqrt(discriminant if discriminant > 0.0 else 0.0) - f1)
    return root if root < dq else dq
