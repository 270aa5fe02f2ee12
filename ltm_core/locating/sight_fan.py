"""Sample the terrain in a sector around a camera: heights along rays of the map, and what stands before what."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ltm_core.base.kernels import kernel
from ltm_core.base.types import Float32Array, Float64Array, Int64Array, UInt8Array
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_seam_kernels import bilinear

NEAREST = 3.0  # range in metres at which a fan begins
_LEAST_STEP = 0.5
_STEP = 0.003  # step as a share of the range
_STEPS_INSIDE = 1_000
NO_LEVEL = np.uint8(255)


@dataclass(frozen=True, eq=False)
class SightFan:
    """Terrain samples of a sector. `azimuths`: (A,) radians, increasing. `ranges`: (R,) horizontal metres, increasing;
    `steps`: (R,) metres from the previous one. `heights`: (A, R) float32 metres, NaN if unknown. `levels`: (A, R)
    uint8, the raster of a stack that a height is from, NO_LEVEL for none."""

    azimuths: Float64Array
    ranges: Float64Array
    steps: Float64Array
    heights: Float32Array
    levels: UInt8Array

    @property
    def widths(self) -> Float64Array:
        """Return (A,) the angle in radians that each azimuth covers."""
        return np.asarray(np.gradient(self.azimuths), np.float64)


def sight_fan(
    dem: Dem,
    position: Float64Array,
    azimuths: Float64Array,
    max_range: float,
    fine: tuple[float, float, float] | None = None,
) -> SightFan:
    """Sample the terrain.

    Args:
        azimuths: (A,) radians, two or more, ascending.
        fine: (from, to, step) metres: the ranges that are sampled at this step, if that is finer than elsewhere."""
    ranges = fan_ranges(max_range, fine)
    heights = np.full((len(azimuths), len(ranges)), np.nan, np.float32)
    levels = np.full(heights.shape, NO_LEVEL, np.uint8)
    sines, cosines = np.sin(azimuths), np.cos(azimuths)
    for number, level in enumerate(dem.levels):
        g = level.geometry
        # Grid coordinates of the camera, and cells a metre.
        col, row = (position[0] - g.x_min) / g.resolution - 0.5, (g.y_max - position[1]) / g.resolution - 0.5
        _sample(level.elevation, row, col, 1 / g.resolution, sines, cosines, ranges, np.uint8(number), heights, levels)
    return SightFan(azimuths, ranges, np.diff(ranges, prepend=NEAREST - _LEAST_STEP), heights, levels)


def fan_ranges(max_range: float, fine: tuple[float, float, float] | None) -> Float64Array:
    """Return the ranges of samples, (R,) metres: steps of 0.3 %, at least half a metre, finer on request."""
    turn = _LEAST_STEP / _STEP
    near = np.arange(NEAREST, min(turn, max_range), _LEAST_STEP)
    far = turn * (1 + _STEP) ** np.arange(max(0.0, np.ceil(np.log(max_range / turn) / np.log1p(_STEP))))
    usual = np.concatenate([near, far])
    usual = usual[usual <= max_range]
    if fine is None:
        return usual
    start, stop, step = max(fine[0], NEAREST), min(fine[1], max_range), fine[2]
    if stop <= start:
        return usual
    inside = usual[(usual >= start) & (usual <= stop)]
    count = min(_STEPS_INSIDE, int(np.ceil((stop - start) / step)) + 1)
    if count <= len(inside):
        return usual
    return np.concatenate([usual[usual < start], np.linspace(start, stop, count), usual[usual > stop]])


@kernel(nogil=True)
def _sample(
    elevation: Float32Array,
    row: float,
    col: float,
    per_metre: float,
    sines: Float64Array,
    cosines: Float64Array,
    ranges: Float64Array,
    number: np.uint8,
    heights: Float32Array,
    levels: UInt8Array,
) -> None:
    """Return the bilinear heights at the places that no finer raster has been over."""
    last_row, last_col = elevation.shape[0] - 1, elevation.shape[1] - 1
    for a in range(len(sines)):
        for k in range(len(ranges)):
            if levels[a, k] != NO_LEVEL:
                continue
            y = row - cosines[a] * ranges[k] * per_metre
            x = col + sines[a] * ranges[k] * per_metre
            if not (0 <= y <= last_row and 0 <= x <= last_col):
                continue
            heights[a, k] = bilinear(elevation, y, x)
            levels[a, k] = number


class Rays(NamedTuple):
    """Terrain and a mark along rays. `heights`, `levels`: (A, R), and `ranges`: (R,), of the `SightFan`. `knots`: (R,)
    the knot of each range. `z0`: height of the camera, metres. `bend`: curvature coefficient of rays.

    Of the mark, (A, J) each: density of the marked azimuth, mean and variance of the marked slope. Of the rasters of
    the terrain, (L,): variance of heights, and metres beyond which their errors are independent (`apart`)."""

    heights: Float32Array
    levels: UInt8Array
    ranges: Float64Array
    knots: Int64Array
    z0: float
    bend: float
    azimuth_density: Float64Array
    slope_mean: Float64Array
    slope_variance: Float64Array
    height_variance: Float64Array
    apart: Float64Array


class SmokeDensities(NamedTuple):
    """Densities of smoke, (A, R) each, filled by the loops: densities with the base `seen` and `hidden`, and these over
    the sample's maximum; `unseen`: chance of a hidden base; `lifts`: metres from which something is visible."""

    seen: Float64Array
    hidden: Float64Array
    seen_fit: Float32Array
    hidden_fit: Float32Array
    unseen: Float32Array
    lifts: Float32Array
