"""Each pixel of a depth image as an observation of the surface: compiled.

A pixel is compared with the range at which its ray would meet the reference surface. Three things can be:

* **It agrees**: it speaks for the cell that the reference says it sees. What it is off by along the ray, times the
  incidence factor, is what the surface there is off by in height.
* **It is nearer**: something stands where the reference has air. It speaks for the cell that it lies in.
* **It is farther**: the ray went through what the reference has as solid. All cells that it passed below the
  surface are capped at the ray's height, and it speaks for the cell that it lies in.

The incidence factor |n.d| / n_z (n: normal of the surface, d: the ray's direction) turns metres along the ray into
metres of height; it is taken over blocks of cells, since a crown's own slopes say nothing of how the canopy is met.
What it cannot tell, it does not claim to know: on the steep side of a crown a small error along the ray is a large one
of height, so the variance takes the slope of the cell itself where that is the steeper one. Whether the stand is as it
was, such a pixel tells far better than how high its cell is: its *sheet variance* is that of the slope of the block.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Image = NDArray[np.float32]
Indices = NDArray[np.int32]
Kinds = NDArray[np.uint8]

NOTHING, AGREES, NEARER, FARTHER = 0, 1, 2, 3

LEAST_INCIDENCE = 0.1
"""Of the incidence factor: a grazing ray's height does not depend on its range, but it is not exact either."""
SKY_SEEN_THROUGH = 40.0
"""Metres behind a vanished skyline that a ray into the sky has certainly passed."""
_LONGEST_CARVE = 400
"""Cells."""
LIKELY_CHANGE = 4.0
"""Metres: the mean of the exponential prior on how much higher a cell has become."""
_SEARCH = 1.5
"""Sigmas of range within which the likeliest place is looked for."""


class Ground(NamedTuple):
    """The reference, as the kernel takes it."""

    surface: Image
    east: Image
    north: Image
    block: int
    x_min: float
    y_max: float
    resolution: float


class View(NamedTuple):
    """One frame's camera: rays (H, W, 3) in the optical frame, rotation to the map, position, pose covariance."""

    rays: Floats
    rotation: Floats
    position: Floats
    covariance: Floats
    bend: float


class Ray(NamedTuple):
    """One ray in the map frame: origin, unit direction, and its bend over slant range."""

    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float
    bend: float


class Limits(NamedTuple):
    min_range: float
    max_range: float
    gate: float
    carve_below: float
    tallest: float
    own_sigma: float
    """Metres of height that no cell is known better than from one frame: the cell is not flat."""


class Pixels(NamedTuple):
    """(H, W): measured slant range and its sigma, whether it is a measurement at all; the range that the reference
    predicts, its extremes within the pose's uncertainty, and within one pixel.
    """

    range: Image
    sigma: Image
    informs: Kinds
    expected: Image
    nearest: Image
    farthest: Image
    near: Image
    far: Image


class Seen(NamedTuple):
    """Observations by pixel, (H * W,): kind, cell (row * width + col), height above the reference, its variance, that
    of a shift of the whole stand (where it agrees), and the part that the pose is to blame for; and what was carved:
    cells with the height of the ray above the reference.
    """

    kind: Kinds
    cell: Indices
    dz: Image
    variance: Image
    sheet_variance: Image
    pose_variance: Image
    carved_cell: Indices
    carved_dz: Image


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def _height_at(ground: Ground, x: float, y: float) -> float:
    """Bilinear; NaN outside the outermost cell centres."""
    col = (x - ground.x_min) / ground.resolution - 0.5
    row = (ground.y_max - y) / ground.resolution - 0.5
    height, width = ground.surface.shape
    if not (row >= 0.0 and col >= 0.0 and row <= height - 1.0 and col <= width - 1.0):
        return math.nan
    r = min(int(row), height - 2)
    c = min(int(col), width - 2)
    fr, fc = row - r, col - c
    z = ground.surface
    north = z[r, c] + fc * (z[r, c + 1] - z[r, c])
    south = z[r + 1, c] + fc * (z[r + 1, c + 1] - z[r + 1, c])
    height_here: float = north + fr * (south - north)
    return height_here


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def _cell_at(ground: Ground, x: float, y: float) -> int:
    """Flat index; -1 outside."""
    col = math.floor((x - ground.x_min) / ground.resolution)
    row = math.floor((ground.y_max - y) / ground.resolution)
    height, width = ground.surface.shape
    if not (row >= 0 and col >= 0 and row < height and col < width):
        return -1
    cell: int = int(row) * width + int(col)
    return cell


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _slopes_at(ground: Ground, cell: int) -> tuple[float, float]:
    width = ground.surface.shape[1]
    r, c = (cell // width) // ground.block, (cell % width) // ground.block
    return np.float64(ground.east[r, c]), np.float64(ground.north[r, c])


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _steepness(ground: Ground, cell: int, dx: float, dy: float, dz: float) -> float:
    """The incidence factor on the cell's own slope; 0 where that is not known."""
    height, width = ground.surface.shape
    r, c = cell // width, cell % width
    z, step = ground.surface, 2 * ground.resolution
    east = (z[r, min(c + 1, width - 1)] - z[r, max(c - 1, 0)]) / step
    north = (z[max(r - 1, 0), c] - z[min(r + 1, height - 1), c]) / step
    steepness: float = abs(dz - east * dx - north * dy)
    return steepness if steepness < math.inf else 0.0


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _pose_variance(covariance: Floats, east: float, north: float, px: float, py: float, pz: float) -> float:
    """Variance of the height of a surface with these slopes, seen at (px, py, pz) from the camera: the row of the
    camera's shift o and turn w in n.(o + w x p) / n_z is [n, p x n] / n_z, with n / n_z = (-east, -north, 1).
    """
    nx, ny = -east, -north
    row = (nx, ny, 1.0, py - pz * ny, pz * nx - px, px * ny - py * nx)
    total = 0.0
    for i in range(6):
        part = 0.0
        for j in range(6):
            part += covariance[i, j] * row[j]
        total += row[i] * part
    return max(total, 0.0)


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def _above(ground: Ground, ray: Ray, t: float) -> float:
    """Height of a ray over the reference surface after `t` metres."""
    z: float = ray.z + ray.dz * t + ray.bend * t * t - _height_at(ground, ray.x + ray.dx * t, ray.y + ray.dy * t)
    return z


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _likeliest(ground: Ground, ray: Ray, r: float, sigma: float, first: float, last: float) -> float:
    """Where along its ray, from `first` to `last`, a thing stands that is not where the reference has it: small changes
    are likelier than large ones, so that a crown has grown rather than the gap before it has filled to the crown's
    height, and what stood behind a felled stand is seen where it stands.
    """
    step = max(ground.resolution, sigma / 8)
    best, least = r, math.inf
    t = max(r - _SEARCH * sigma, first)
    end = min(r + _SEARCH * sigma, last)
    while t < end:
        cost = 0.5 * ((t - r) / sigma) ** 2 + abs(_above(ground, ray, t)) / LIKELY_CHANGE
        if cost < least:
            best, least = t, cost
        t += step
    return best


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def observe(ground: Ground, view: View, pixels: Pixels, limits: Limits, seen: Seen) -> int:
    """Fill `seen`; the number of carved cells. Carving ends silently where its arrays are full.

    Rows are taken from the bottom up: where a ray has carved, the one above it in its column passes higher, and goes on
    where that ended. So an image carves a cell a few times, and not once for each ray over it.
    """
    rows, cols = pixels.range.shape
    carved = 0
    reached = np.zeros(cols, np.float64)
    own = limits.own_sigma**2
    m = view.rotation
    x0, y0, z0 = view.position[0], view.position[1], view.position[2]
    for v in range(rows - 1, -1, -1):
        for u in range(cols):
            i = v * cols + u
            seen.kind[i] = NOTHING
            before, reached[u] = reached[u], 0.0
            r, sigma, expected = float(pixels.range[v, u]), float(pixels.sigma[v, u]), float(pixels.expected[v, u])
            # Unknown depth, sigma or reference; depth that was copied from the reference.
            if pixels.informs[v, u] == 0 or not r > limits.min_range or not sigma > 0.0 or math.isnan(expected):
                continue
            if r > limits.max_range and expected > limits.max_range:
                continue
            a, b, c = view.rays[v, u, 0], view.rays[v, u, 1], view.rays[v, u, 2]
            dx = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c
            dy = m[1, 0] * a + m[1, 1] * b + m[1, 2] * c
            dz = m[2, 0] * a + m[2, 1] * b + m[2, 2] * c
            flat2 = dx * dx + dy * dy
            nearest, farthest = float(pixels.nearest[v, u]), float(pixels.farthest[v, u])
            slack = limits.gate * sigma
            if math.isinf(r):
                slack = 0.0
            elif math.isinf(sigma):
                continue
            if not math.isinf(r) and nearest - slack <= r <= farthest + slack:
                if math.isinf(expected):
                    continue
                x, y = x0 + dx * expected, y0 + dy * expected
                cell = _cell_at(ground, x, y)
                if cell < 0:
                    continue
                east, north = _slopes_at(ground, cell)
                incidence = max(abs(dz - east * dx - north * dy), LEAST_INCIDENCE)
                # Where neighbouring pixels see other ranges, a pixel's own direction is not exact enough.
                spread = 0.0
                if not math.isinf(pixels.far[v, u]):
                    spread = 0.5 * (pixels.far[v, u] - pixels.near[v, u])
                elif not math.isinf(pixels.near[v, u]):
                    spread = expected - pixels.near[v, u]
                # What only pixels beside it would see, a silhouette a little off its place, tells nothing.
                if not abs(r - expected) <= slack + min(spread, slack):
                    continue
                off = (r - expected) * incidence
                seen.kind[i] = AGREES
                seen.cell[i] = cell
                seen.dz[i] = -off
                steep = max(incidence, _steepness(ground, cell, dx, dy, dz))
                aside = (spread * incidence) ** 2 + own
                seen.variance[i] = (sigma * steep) ** 2 + aside
                seen.sheet_variance[i] = (sigma * incidence) ** 2 + aside
                z = dz * expected + view.bend * flat2 * expected * expected
                seen.pose_variance[i] = _pose_variance(view.covariance, east, north, x - x0, y - y0, z)
                continue
            farther = r > farthest + slack
            if farther and not math.isinf(expected):
                end = min(expected + SKY_SEEN_THROUGH, limits.max_range) if math.isinf(r) else r - slack
                step = ground.resolution / max(math.sqrt(flat2), 0.1)
                t = max(expected, before) + 0.5 * step
                reached[u] = max(end, before)
                for _ in range(_LONGEST_CARVE):
                    if t >= end or carved >= len(seen.carved_cell):
                        break
                    x, y = x0 + dx * t, y0 + dy * t
                    above = z0 + dz * t + view.bend * flat2 * t * t - _height_at(ground, x, y)
                    if above < -limits.carve_below:
                        cell = _cell_at(ground, x, y)
                        if cell >= 0:
                            seen.carved_cell[carved] = cell
                            seen.carved_dz[carved] = above
                            carved += 1
                    t += step
            if math.isinf(r) or r > limits.max_range:
                continue
            ray = Ray(x0, y0, z0, dx, dy, dz, view.bend * flat2)
            first, last = (expected, math.inf) if farther else (0.0, expected)
            r = _likeliest(ground, ray, r, sigma, first, last)
            x, y = x0 + dx * r, y0 + dy * r
            cell = _cell_at(ground, x, y)
            if cell < 0:
                continue
            above = _above(ground, ray, r)
            if not abs(above) <= limits.tallest:
                continue
            east, north = _slopes_at(ground, cell)
            incidence = max(abs(dz - east * dx - north * dy), LEAST_INCIDENCE)
            seen.kind[i] = FARTHER if farther else NEARER
            seen.cell[i] = cell
            seen.dz[i] = above
            # Among crowns, a little nearer or farther is a lot higher or lower.
            rough = abs(_above(ground, ray, r + 0.5 * sigma) - _above(ground, ray, r - 0.5 * sigma))
            known = rough if rough < math.inf else 0.0
            seen.variance[i] = max(sigma * incidence, known) ** 2 + own
            z = dz * r + view.bend * flat2 * r * r
            seen.pose_variance[i] = _pose_variance(view.covariance, east, north, x - x0, y - y0, z)
    return carved
