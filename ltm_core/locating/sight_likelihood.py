"""How likely a mark is for each place of a fan: the probability density of the marked direction, given the place.

**Where something on the ground is marked** at its own direction. Where the terrain model hides the place by a little,
its error may be the reason: the place then counts by the chance of that.

**Where smoke is marked** at the lowest part of it that is seen. That is its foot where it is seen. Behind a crest it is
where the plume comes up over the crest: in height, the running maximum of the terrain's slopes from the camera to the
place, the same for all places behind one crest; in azimuth, the foot's and what the plume has drifted sideways until
there. `lifts` says how high smoke must stand at a place; a plume is the less likely to be so high.

Slopes of the place and of the crest have errors by the terrain model's, so that which one is higher may not be certain.

Along a ray the slope changes from sample to sample; the density is averaged over that change in closed form, or near
and steep ground would fall between the samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from ltm_core.dem import Dem
from ltm_core.locating.directions import KNOTS, MarkedDirections
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sight_fan import NO_LEVEL, SightFan
from ltm_core.types import Float32Array, Float64Array, Int64Array, UInt8Array

LEVEL_SHARE = 0.1
"""Of a raster's cell size: the least sigma that its heights have between its nodes."""
APART_CELLS = 4.0
"""Cells from which errors of a raster's heights count as independent."""
DRIFTS = np.array([0.0, 0.0015, 0.004, 0.01, 0.025])
"""Radians of sideways drift, sigma, for which azimuths are worked out."""
_NEXT_DRIFT = np.concatenate([[DRIFTS[1] / 2], np.sqrt(DRIFTS[1:-1] * DRIFTS[2:])])
_ROOT_2PI = math.sqrt(2 * math.pi)


@dataclass(frozen=True, eq=False)
class DirectionTable:
    """Marked directions by DRIFTS, azimuth of the fan and knot of range: `density` (D, A, J) of the azimuth; `slope`,
    `variance` (A, J) of the slope there, without drift.
    """

    density: Float64Array
    slope: Float64Array
    variance: Float64Array


def direction_table(directions: MarkedDirections, azimuths: Float64Array, drifting: bool) -> DirectionTable:
    """Each marked place is a normal distribution of azimuth and slope; over the places, the slope's distribution at an
    azimuth is taken by its mean and variance.
    """
    c = directions.covariance
    off = azimuths[:, None, None] - directions.azimuth[None, :, None]
    drifts = DRIFTS if drifting else DRIFTS[:1]
    density = np.zeros((len(drifts), len(azimuths), len(KNOTS)))
    for number, drift in enumerate(drifts):
        variance = c[..., 0, 0] + drift**2
        parts = directions.weights[:, None] / np.sqrt(2 * np.pi * variance) * np.exp(-0.5 * off**2 / variance)
        density[number] = parts.sum(axis=1)
        if number == 0:
            slope = directions.slope[:, None] + c[..., 0, 1] / c[..., 0, 0] * off
            left = c[..., 1, 1] - c[..., 0, 1] ** 2 / c[..., 0, 0]
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = (parts * slope).sum(axis=1) / density[0]
                spread = (parts * (left + slope**2)).sum(axis=1) / density[0] - mean**2
    none = density[0] < 1e-7 * density[0].max()
    density[0][none] = 0.0
    middle = float(directions.slope @ directions.weights)
    return DirectionTable(density, np.where(none, middle, mean), np.where(none, 1.0, spread))


def slope_table(directions: MarkedDirections, azimuths: int) -> DirectionTable:
    """The mark's slope alone, alike at so many azimuths."""
    slope = float(directions.slope @ directions.weights)
    variance = (
        directions.weights @ directions.covariance[..., 1, 1] + directions.weights @ (directions.slope - slope) ** 2
    )
    shape = (azimuths, len(KNOTS))
    return DirectionTable(np.ones((1, *shape)), np.full(shape, slope), np.broadcast_to(variance, shape).copy())


def level_errors(dem: Dem, config: LocatingConfig) -> tuple[Float64Array, Float64Array]:
    """By raster of the terrain, (L,): variance of heights, and metres from which their errors are independent."""
    resolutions = np.array([level.geometry.resolution for level in dem.levels])
    return np.maximum(config.dem_sigma, LEVEL_SHARE * resolutions) ** 2, APART_CELLS * resolutions


@dataclass(frozen=True, eq=False)
class SightLikelihood:
    """Of the samples of a fan, (A, R) each. `density`: of the marked direction. `fit`: that over the greatest that the
    sample could have, were the mark where it is best for it: 1 where all agrees. `lifts`: metres above the ground from
    which something is seen.
    """

    density: Float64Array
    fit: Float32Array
    lifts: Float32Array


def sight_likelihood(
    fan: SightFan,
    table: DirectionTable,
    height: float,
    bend: float,
    variances: Float64Array,
    apart: Float64Array,
    smoke: bool,
    lean: float = 0.0,
) -> SightLikelihood:
    """What the mark says of each sample.

    Args:
        height: of the camera, metres.
        variances: of the terrain's heights, by raster of the stack, square metres.
        apart: metres from which errors of these heights are independent, by raster.
        smoke: what is marked is the lowest visible part of smoke, not something on the ground.
        lean: of a plume, `LocatingConfig.plume_lean`.
    """
    density = np.zeros(fan.heights.shape)
    fit, lifts = np.zeros(fan.heights.shape, np.float32), np.zeros(fan.heights.shape, np.float32)
    knots = np.clip(np.searchsorted(KNOTS, fan.ranges), 0, len(KNOTS) - 1)
    _likelihood(
        *(fan.heights, fan.levels, fan.ranges, fan.widths, knots, height, bend, table.density),
        *(table.density.max(axis=1), table.slope, table.variance, variances, apart, smoke, lean, _NEXT_DRIFT),
        *(density, fit, lifts),
    )
    return SightLikelihood(density, fit, lifts)


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _likelihood(
    heights: Float32Array,
    levels: UInt8Array,
    ranges: Float64Array,
    widths: Float64Array,
    knots: Int64Array,
    z0: float,
    bend: float,
    azimuth_density: Float64Array,
    azimuth_peak: Float64Array,
    slope_mean: Float64Array,
    slope_variance: Float64Array,
    height_variance: Float64Array,
    apart: Float64Array,
    smoke: bool,
    lean: float,
    next_drift: Float64Array,
    density: Float64Array,
    fit: Float32Array,
    lifts: Float32Array,
) -> None:
    drifts = azimuth_density.shape[0]
    # How smoke from behind what is nearer than a range agrees with the marked slope, over the marked azimuths.
    over_crest, crest_fit, marked = np.zeros(len(ranges)), np.zeros(len(ranges)), np.zeros(len(ranges))
    slopes = np.empty(len(ranges))
    for a in range(heights.shape[0]):
        top, top_k = -np.inf, 0
        far, far_k, behind = -np.inf, 0, 0
        before = np.nan
        for k in range(heights.shape[1]):
            level = levels[a, k]
            if level == NO_LEVEL or heights[a, k] != heights[a, k]:
                before, slopes[k] = np.nan, -np.inf  # unknown ground hides nothing and nothing is looked for there
                continue
            r = ranges[k]
            slope = (heights[a, k] - z0) / r - bend * r
            slopes[k] = slope
            # The highest crest whose height has errors of its own.
            while ranges[behind] < r - apart[level]:
                if slopes[behind] >= far:
                    far, far_k = slopes[behind], behind
                behind += 1
            here = azimuth_density[0, a, knots[k]]
            if smoke and here <= 0:
                edge, own, at = max(slope, top), 0.0, k  # beside the mark only what is hidden matters
            elif smoke:
                near, near_k = (slope, k) if slope >= top or top_k == far_k else (top, top_k)
                edge, own, at = _higher(
                    near,
                    height_variance[levels[a, near_k]] / ranges[near_k] ** 2,
                    near_k,
                    far,
                    height_variance[levels[a, far_k]] / ranges[far_k] ** 2,
                    far_k,
                )
            else:
                edge, own, at = slope, height_variance[level] / r**2, k
            lift = (max(top, edge) - slope) * r
            if slope >= top:
                top, top_k = slope, k
            lifts[a, k] = lift
            low = edge if before != before else before
            before = edge
            if here <= 0:
                continue
            sigma = math.sqrt(slope_variance[a, knots[at]] + own)
            mean = slope_mean[a, knots[at]]
            value = _mean_density((low - mean) / sigma, (edge - mean) / sigma)
            if smoke:
                over_crest[k] += value / sigma * here * widths[a]
                crest_fit[k] += value * here * widths[a]
                marked[k] += here * widths[a]
            elif lift > 0:
                crest = height_variance[levels[a, top_k]] * (r / ranges[top_k]) ** 2
                value *= math.erfc(lift / math.sqrt(2.0 * (height_variance[level] + crest) + 1e-6))
            density[a, k] = value / sigma * here
            fit[a, k] = value * _ROOT_2PI * here / azimuth_peak[0, knots[k]]
    if not smoke or drifts < 2:
        return
    for a in range(heights.shape[0]):
        for k in range(heights.shape[1]):
            if marked[k] <= 0:
                continue
            drift = lean * lifts[a, k] / ranges[k]
            if drift > next_drift[0]:
                number = 1
                while number < drifts - 1 and drift > next_drift[number]:
                    number += 1
                here = azimuth_density[number, a, knots[k]]
                density[a, k] = here * over_crest[k] / marked[k]
                fit[a, k] = _ROOT_2PI * crest_fit[k] / marked[k] * here / azimuth_peak[number, knots[k]]


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _higher(
    near: float, near_variance: float, near_k: int, far: float, far_variance: float, far_k: int
) -> tuple[float, float, int]:
    """Mean and variance of the higher of two slopes whose errors are independent, and which it rather is (Clark, The
    greatest of a finite set of random variables, Operations Research 9, 1961).
    """
    if far == -np.inf or near_k == far_k:
        return near, near_variance, near_k
    spread = math.sqrt(near_variance + far_variance) + 1e-12
    off = near - far
    alpha = off / spread
    if alpha > 4:
        return near, near_variance, near_k
    if alpha < -4:
        return far, far_variance, far_k
    share = 0.5 * math.erfc(-alpha / math.sqrt(2.0))
    shape = spread * math.exp(-0.5 * alpha**2) / _ROOT_2PI
    above = off * share + shape
    second = (off**2 + near_variance) * share + far_variance * (1 - share) + off * shape
    return far + above, max(second - above**2, 0.0), near_k if alpha > 0 else far_k


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _mean_density(first: float, last: float) -> float:
    """Mean of the standard normal density between two values."""
    if min(abs(first), abs(last)) > 7 and first * last > 0:
        return 0.0
    if abs(last - first) > 0.3:
        return float((math.erf(last / math.sqrt(2.0)) - math.erf(first / math.sqrt(2.0))) / (2 * (last - first)))
    return float(math.exp(-0.125 * (first + last) ** 2) / _ROOT_2PI)
