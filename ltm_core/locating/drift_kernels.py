"""Plumes that drift sideways before they show: of places whose foot is hidden, what is marked is not over the foot."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ltm_core.locating.kernel_arguments import Drifts, RayMark, RayTerrain, SmokeDensities
from ltm_core.locating.sight_fan import NO_LEVEL
from ltm_core.types import Float64Array

_REACH = 2.5
"""Sigmas of drift to which neighbouring azimuths count."""
_NEIGHBOURS = 9


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def add_drifted(terrain: RayTerrain, mark: RayMark, drifting: Drifts, found: SmokeDensities) -> None:
    """Makes densities of the marked direction out of those of its slope, in place. Smoke of a hidden foot comes up at
    the marked azimuths, wherever the foot is: over these its slope's density is averaged, range by range.
    """
    heights, levels, ranges, knots, z0, bend = terrain
    widths, azimuth_density, azimuth_peak, lean, next_drift = drifting
    slope_mean = mark.slope_mean
    density, hidden, fit, hidden_fit, unseen, lifts = found
    over, over_fit, marked = np.zeros(len(ranges)), np.zeros(len(ranges)), np.zeros(len(ranges))
    for a in range(heights.shape[0]):
        for k in range(heights.shape[1]):
            here = azimuth_density[0, a, knots[k]] * widths[a]
            if here > 0 and levels[a, k] != NO_LEVEL:
                over[k] += (density[a, k] + hidden[a, k]) * here
                over_fit[k] += (fit[a, k] + hidden_fit[a, k]) * here
                marked[k] += here
    drifts = azimuth_density.shape[0]
    for a in range(heights.shape[0]):
        for k in range(heights.shape[1]):
            if levels[a, k] == NO_LEVEL or heights[a, k] != heights[a, k]:
                continue
            knot = knots[k]
            here, peak = azimuth_density[0, a, knot], azimuth_peak[0, knot]
            seen, seen_fit = density[a, k] * here, fit[a, k] * here / peak
            behind, behind_fit = hidden[a, k] * here, hidden_fit[a, k] * here / peak
            r = ranges[k]
            above = slope_mean[a, knot] - ((heights[a, k] - z0) / r - bend * r)
            drift = lean * above
            if drifts > 1 and drift > next_drift[0] and marked[k] > 0 and unseen[a, k] > 0:
                number = 1
                while number < drifts - 1 and drift > next_drift[number]:
                    number += 1
                here, peak = azimuth_density[number, a, knot], azimuth_peak[number, knot]
                behind = here * unseen[a, k] * over[k] / marked[k]
                behind_fit = here / peak * unseen[a, k] * over_fit[k] / marked[k]
                if seen + behind > 0:
                    lifts[a, k] = behind / (seen + behind) * above * r
            density[a, k] = seen + behind
            fit[a, k] = seen_fit + behind_fit


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def add_smeared(terrain: RayTerrain, mark: RayMark, azimuths: Float64Array, lean: float, found: SmokeDensities) -> None:
    """Adds to the slope's density at a seen foot that at a hidden one, averaged over the azimuths to which a plume may
    have drifted; evenly spaced azimuths.
    """
    heights, levels, ranges, knots, z0, bend = terrain
    slope_mean = mark.slope_mean
    density, hidden, fit, hidden_fit = found.seen, found.hidden, found.seen_fit, found.hidden_fit
    count = len(azimuths)
    spacing = (azimuths[-1] - azimuths[0]) / (count - 1)
    for a in range(count):
        for k in range(heights.shape[1]):
            if levels[a, k] == NO_LEVEL or heights[a, k] != heights[a, k]:
                continue
            r = ranges[k]
            above = slope_mean[a, knots[k]] - ((heights[a, k] - z0) / r - bend * r)
            drift = lean * max(above, 0.0)
            step = max(1, math.ceil(2 * _REACH * drift / spacing / (_NEIGHBOURS - 1))) if spacing > 0 else 1
            total, value, value_fit = 0.0, 0.0, 0.0
            for n in range(-(_NEIGHBOURS // 2), _NEIGHBOURS // 2 + 1):
                b = a + n * step
                if b < 0 or b >= count or levels[b, k] == NO_LEVEL:
                    continue
                off = n * step * spacing
                weight = math.exp(-0.5 * (off / (drift + 1e-9)) ** 2)
                total += weight
                value += weight * hidden[b, k]
                value_fit += weight * hidden_fit[b, k]
            density[a, k] += value / total
            fit[a, k] += value_fit / total
