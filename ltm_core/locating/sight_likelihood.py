"""How likely a mark is for each place of a fan: the probability density of the marked direction, given the place.

**Where something on the ground is marked** at its own direction. Where the terrain model hides the place by a little,
its error may be the reason: the place then counts by the chance of that.

**Where smoke is marked** at the lowest part of it that is seen. That is its foot where it is seen. Behind a crest it is
where the plume comes up over the crest: in height, the running maximum of the terrain's slopes from the camera to the
place, the same for all places behind one crest; in azimuth, the foot's and what the plume has drifted sideways until
there. `lifts` says how high smoke must stand at a place; a plume is the less likely to be so high.

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

    @property
    def peak(self) -> float:
        """The greatest density of a direction."""
        here = self.density[0] > 0
        return float((self.density[0][here] / np.sqrt(2 * np.pi * self.variance[here])).max())


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


def level_sigmas(dem: Dem, config: LocatingConfig) -> Float64Array:
    """Sigma of the heights of each raster of the terrain, (L,) metres."""
    return np.array([max(config.dem_sigma, LEVEL_SHARE * level.geometry.resolution) for level in dem.levels])


def sight_likelihood(
    fan: SightFan,
    table: DirectionTable,
    height: float,
    bend: float,
    sigmas: Float64Array,
    smoke: bool,
    lean: float = 0.0,
) -> tuple[Float64Array, Float32Array]:
    """Density of the marked direction, and metres above ground from which something is seen, (A, R) each.

    Args:
        height: of the camera, metres.
        sigmas: of the terrain's heights, by raster of the stack.
        smoke: what is marked is the lowest visible part of smoke, not something on the ground.
        lean: of a plume, `LocatingConfig.plume_lean`.
    """
    density = np.zeros(fan.heights.shape)
    lifts = np.zeros(fan.heights.shape, np.float32)
    knots = np.clip(np.searchsorted(KNOTS, fan.ranges), 0, len(KNOTS) - 1)
    _likelihood(
        *(fan.heights, fan.levels, fan.ranges, fan.widths, knots, height, bend, table.density),
        *(table.slope, table.variance, sigmas**2, smoke, lean, _NEXT_DRIFT, density, lifts),
    )
    return density, lifts


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
    slope_mean: Float64Array,
    slope_variance: Float64Array,
    height_variance: Float64Array,
    smoke: bool,
    lean: float,
    next_drift: Float64Array,
    density: Float64Array,
    lifts: Float32Array,
) -> None:
    drifts = azimuth_density.shape[0]
    # Density of the slope at which smoke comes up from behind what is nearer than a range, over the marked azimuths.
    over_crest, marked = np.zeros(len(ranges)), np.zeros(len(ranges))
    for a in range(heights.shape[0]):
        top, top_k = -np.inf, 0
        before = np.nan
        for k in range(heights.shape[1]):
            if levels[a, k] == NO_LEVEL or heights[a, k] != heights[a, k]:
                before = np.nan  # unknown ground hides nothing and nothing is looked for there
                continue
            r = ranges[k]
            slope = (heights[a, k] - z0) / r - bend * r
            lift = 0.0
            if slope >= top:
                top, top_k = slope, k
            else:
                lift = (top - slope) * r
            lifts[a, k] = lift
            edge = top if smoke else slope
            low = edge if before != before else before
            before = edge
            here = azimuth_density[0, a, knots[k]]
            if here <= 0:
                continue
            # What is seen of smoke is seen at the crest: by its error, and the position's at its range.
            at = top_k if smoke else k
            mean = slope_mean[a, knots[at]]
            sigma = math.sqrt(slope_variance[a, knots[at]] + height_variance[levels[a, at]] / ranges[at] ** 2)
            value = _mean_density((low - mean) / sigma, (edge - mean) / sigma) / sigma
            if smoke:
                over_crest[k] += value * here * widths[a]
                marked[k] += here * widths[a]
            elif lift > 0:
                crest = height_variance[levels[a, top_k]] * (r / ranges[top_k]) ** 2
                value *= math.erfc(lift / math.sqrt(2.0 * (height_variance[levels[a, k]] + crest) + 1e-6))
            density[a, k] = value * here
    if not smoke or drifts < 2:
        return
    for a in range(heights.shape[0]):
        for k in range(heights.shape[1]):
            drift = lean * lifts[a, k] / ranges[k]
            if drift > next_drift[0] and marked[k] > 0:
                number = 1
                while number < drifts - 1 and drift > next_drift[number]:
                    number += 1
                density[a, k] = azimuth_density[number, a, knots[k]] * over_crest[k] / marked[k]


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _mean_density(first: float, last: float) -> float:
    """Mean of the standard normal density between two values."""
    if min(abs(first), abs(last)) > 7 and first * last > 0:
        return 0.0
    if abs(last - first) > 0.3:
        return float((math.erf(last / math.sqrt(2.0)) - math.erf(first / math.sqrt(2.0))) / (2 * (last - first)))
    return float(math.exp(-0.125 * (first + last) ** 2) / _ROOT_2PI)
