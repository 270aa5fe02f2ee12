"""Puts what is known along the rays of a fan on a raster of the map: means over the samples in each cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ltm_core.grid import GridGeometry
from ltm_core.locating.kernel_arguments import CellSums, FanSamples
from ltm_core.locating.sight_fan import SightFan
from ltm_core.locating.sight_likelihood import SightLikelihood
from ltm_core.types import BoolArray, Float32Array, Float64Array


@dataclass(frozen=True, eq=False)
class SightRaster:
    """Of one fan, (H, W) each. `density`: of the marked direction, given the cell; 0 where the fan has no sample.
    `fit`: of the cell's best sample (`SightLikelihood.fit`). `lift`: metres above the ground from which something is
    seen, of the likelier parts of the cell.
    """

    density: Float64Array
    fit: Float64Array
    lift: Float64Array

    @property
    def reached(self) -> BoolArray:
        return np.asarray(self.density > 0)


def sight_raster(
    fan: SightFan, likelihood: SightLikelihood, position: Float64Array, window: GridGeometry
) -> SightRaster:
    """Every sample stands for its part of the sector, as long as its step and as wide as its azimuth's share."""
    samples = FanSamples(fan.ranges, fan.steps, fan.widths, np.sin(fan.azimuths), np.cos(fan.azimuths))
    sums = CellSums(*(np.zeros(window.shape) for _ in range(4)))
    x0, y0 = (position[0] - window.x_min) / window.resolution, (window.y_max - position[1]) / window.resolution
    densities = likelihood.density, likelihood.fit, likelihood.lifts
    _splat(samples, *densities, x0, y0, 1 / window.resolution, sums)
    total, area, lift, fit = sums
    with np.errstate(invalid="ignore", divide="ignore"):
        return SightRaster(np.where(area > 0, total / area, 0.0), fit, np.where(total > 0, lift / total, 0.0))


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _splat(
    samples: FanSamples,
    density: Float64Array,
    fits: Float32Array,
    lifts: Float32Array,
    x0: float,
    y0: float,
    per_metre: float,
    sums: CellSums,
) -> None:
    ranges, steps, widths, sines, cosines = samples
    total, area, lift, fit = sums
    height, width = total.shape
    for a in range(density.shape[0]):
        for k in range(density.shape[1]):
            r = ranges[k] - 0.5 * steps[k]
            x, y = x0 + sines[a] * r * per_metre, y0 - cosines[a] * r * per_metre
            if not (0 <= x < width and 0 <= y < height):
                continue
            i, j = int(y), int(x)
            part = r * steps[k] * widths[a]
            area[i, j] += part
            value = density[a, k] * part
            if value > 0:
                total[i, j] += value
                lift[i, j] += value * lifts[a, k]
                fit[i, j] = max(fit[i, j], fits[a, k])
