"""Compare each pixel of a depth image with the reference surface and form an observation of a cell; compiled.

* A range that **agrees** with the reference is an observation of the cell that the reference predicts.
* A **nearer** range is an observation of the cell that the point lies in: something stands there.
* A **farther** one, if all around it are farther too, is also one of the cell that it lies in, and caps all cells that
  the ray passed below the surface.

The relative variance is that of a change of the whole stand (docs/how/surface.md)."""

import math
from typing import NamedTuple

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float32Array, RecordArray, UInt8Array
from ltm_core.surface.cell_layout import FrameSums, place_of, sum_of
from ltm_core.surface.reference_surface import (
    LEAST_INCIDENCE,
    CameraView,
    ReferenceGrid,
    cell_at,
    direction,
    height_at,
    pose_variance,
    slopes_at,
)

SKY_SEEN_THROUGH = 40.0
"""Metres behind a vanished skyline that a ray into the sky has certainly passed."""
_LONGEST_CARVE = 400
"""Maximum number of cells carved by a ray."""
LIKELY_CHANGE = 4.0
"""Mean of the exponential prior on a cell's rise in metres."""
_SEARCH = 1.5
"""Number of sigmas of range within which the most likely place is searched."""


class Ray(NamedTuple):
    """One ray in the map frame: origin, unit direction, and its bend over slant range."""

    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float
    bend: float


class ObservationLimits(NamedTuple):
    min_range: float
    max_range: float
    gate: float
    carve_below: float
    tallest: float
    own_sigma: float
    """Minimum standard deviation in metres of a cell's height from one frame, because the cell is not flat."""
    stands: float
    """Height in metres above which a cell has a standing object."""


class Pixels(NamedTuple):
    """Pixels of a whole image (H, W), of which every `step`-th row and column is used: depth along the optical axis,
    its sigma, and whether it is a measurement. `cosines`: of the pixels in use, depth / slant
    range."""

    depth: Float32Array
    sigma: Float32Array
    informs: UInt8Array
    step: int
    cosines: Float32Array


@helper(inline="always")
def _above(ground: ReferenceGrid, ray: Ray, t: float) -> float:
    """Return the height of a ray over the reference surface after `t` metres."""
    z: float = ray.z + ray.dz * t + ray.bend * t * t - height_at(ground, ray.x + ray.dx * t, ray.y + ray.dy * t)
    return z


@helper()
def _likeliest(ground: ReferenceGrid, ray: Ray, r: float, sigma: float, first: float, last: float) -> float:
    """Return the most likely range of an object that the reference does not have, from `first` to `last`: small changes
    of the surface are likelier than large ones."""
    step = max(ground.resolution, sigma / 8)
    begin = max(r - _SEARCH * sigma, first)
    end = min(r + _SEARCH * sigma, last)
    best, least = r, math.inf
    for i in range(int((end - begin) / step) + 1):
        t = begin + i * step
        cost = 0.5 * ((t - r) / sigma) ** 2 + abs(_above(ground, ray, t)) / LIKELY_CHANGE
        if t < end and cost < least:
            best, least = t, cost
    return best


@helper()
def _leaves_known(ground: ReferenceGrid, ray: Ray, begin: float, end: float) -> bool:
    """Return whether the terrain is not known all along under a ray between two ranges."""
    steps = max(int((end - begin) / (ground.block * ground.resolution)), 1)
    for i in range(steps + 1):
        t = begin + (end - begin) * i / steps
        if math.isnan(height_at(ground, ray.x + ray.dx * t, ray.y + ray.dy * t)):
            return True
    return False


@helper()
def _carve(
    ground: ReferenceGrid, ray: Ray, begin: float, end: float, below: float, r: float, sigma: float, sums: FrameSums
) -> None:
    """Cap the cells over which a ray is less than `below` metres above the reference, between two ranges. `r`, `sigma`:
    the measured range, which determines how surely it passed each of them."""
    stride = ground.resolution / max(math.sqrt(ray.dx * ray.dx + ray.dy * ray.dy), 0.1)
    for i in range(min(int((end - begin) / stride + 0.5), _LONGEST_CARVE)):
        t = begin + (i + 0.5) * stride
        above = _above(ground, ray, t)
        if above < below:
            row, col = cell_at(ground, ray.x + ray.dx * t, ray.y + ray.dy * t)
            number = sum_of(sums, place_of(row, col, ground.across)) if row >= 0 else -1
            if number >= 0 and above < sums.cells[number].lowest:
                sums.cells[number].lowest = above
                sums.cells[number].passed = math.inf if math.isinf(r) else (r - t) / sigma


@kernel()
def observe(
    ground: ReferenceGrid,
    view: CameraView,
    expected_pixels: RecordArray,
    pixels: Pixels,
    beside: Float32Array,
    limits: ObservationLimits,
    sums: FrameSums,
) -> None:
    """Add a frame's observations up by cell, as far as `sums` has room. `beside`: of the pixels in use (H, W), the
    least depth among each and those around it. Rows are processed from the bottom up, and a ray carves only beyond the
    one below it."""
    rows, cols = expected_pixels.shape
    step = pixels.step
    reached = np.zeros(cols, np.float64)
    own = limits.own_sigma**2
    x0, y0, z0 = view.position[0], view.position[1], view.position[2]
    for v in range(rows - 1, -1, -1):
        for u in range(cols - 1, -1, -1):
            before, reached[u] = reached[u], 0.0
            pixel = expected_pixels[v, u]
            expected = float(pixel.expected)
            # Nothing was measured, or no reference.
            if math.isnan(expected) or pixels.informs[v * step, u * step] == 0:
                continue
            along = pixels.cosines[v, u]
            r = float(pixels.depth[v * step, u * step] / along)
            if not r > limits.min_range or (r > limits.max_range and expected > limits.max_range):
                continue
            sigma = float(pixels.sigma[v * step, u * step] / along)
            if not sigma > 0.0:
                continue
            nearest, farthest = float(pixel.nearest), float(pixel.farthest)
            slack = limits.gate * sigma
            if math.isinf(r):
                slack = 0.0
            elif math.isinf(sigma):
                continue
            if not math.isinf(r) and nearest - slack <= r <= farthest + slack:
                spread = float(pixel.spread)
                # What only pixels beside it would see, a silhouette a little off its place, tells nothing.
                if pixel.place < 0 or not abs(r - expected) <= slack + min(spread, slack):
                    continue
                number = sum_of(sums, pixel.place)
                if number < 0:
                    continue
                incidence = float(pixel.incidence)
                aside = (spread * incidence) ** 2 + own
                variance = (sigma * pixel.steep) ** 2 + aside
                w = 1.0 / (variance + pixel.pose_variance)
                one = sums.cells[number]
                one.number += 1.0
                one.weight += w
                one.moment += w * ((expected - r) * incidence)
                one.relative_variance += (sigma * incidence) ** 2 + aside
                one.pose += pixel.pose_variance
                continue
            dx, dy, dz = direction(view, v, u)
            flat2 = dx * dx + dy * dy
            ray = Ray(x0, y0, z0, dx, dy, dz, view.bend * flat2)
            farther = r > farthest + slack
            # Leaves let rays through here and there: where a pixel beside it sees the crown, nothing has gone.
            if farther and not beside[v, u] / along > farthest + min(sigma, slack):
                continue
            if farther and not math.isinf(expected):
                end = min(expected + SKY_SEEN_THROUGH, limits.max_range) if math.isinf(r) else r - slack
                reached[u] = max(end, before)
                _carve(ground, ray, max(expected, before), end, -limits.carve_below, r, sigma, sums)
            if math.isinf(r) or r > limits.max_range:
                continue
            # A point at the terrain's edge may be beyond it, on unknown ground.
            if math.isinf(expected) and _leaves_known(ground, ray, r, r + sigma):
                continue
            first, last = (expected, math.inf) if farther else (0.0, expected)
            r = _likeliest(ground, ray, r, sigma, first, last)
            x, y = x0 + dx * r, y0 + dy * r
            row, col = cell_at(ground, x, y)
            if row < 0:
                continue
            above = _above(ground, ray, r)
            if not abs(above) <= limits.tallest:
                continue
            number = sum_of(sums, place_of(row, col, ground.across))
            if number < 0:
                continue
            east, north = slopes_at(ground, row, col)
            incidence = max(abs(dz - east * dx - north * dy), LEAST_INCIDENCE)
            # Among crowns, a little nearer or farther is a lot higher or lower.
            rough = abs(_above(ground, ray, r + 0.5 * sigma) - _above(ground, ray, r - 0.5 * sigma))
            known = rough if rough < math.inf else 0.0
            variance = max(sigma * incidence, known) ** 2 + own
            z = dz * r + view.bend * flat2 * r * r
            pose = pose_variance(view.covariance, east, north, x - x0, y - y0, z)
            w = 1.0 / (variance + pose)
            one = sums.cells[number]
            one.off_count += 1.0
            one.off_weight += w
            one.off_moment += w * above
            one.off_pose += pose
