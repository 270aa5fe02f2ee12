"""What the loops along a fan's rays take together. Arrays (A, R) are by azimuth and range; J knots of range (KNOTS)."""

from __future__ import annotations

from typing import NamedTuple

from ltm_core.types import Float32Array, Float64Array, Int64Array, UInt8Array


class RayTerrain(NamedTuple):
    """`heights`, `levels`: (A, R), and `ranges`: (R,), of the `SightFan`. `knots`: (R,) the knot of each range. `z0`:
    height of the camera, metres. `bend`: curvature coefficient of rays.
    """

    heights: Float32Array
    levels: UInt8Array
    ranges: Float64Array
    knots: Int64Array
    z0: float
    bend: float


class RayMark(NamedTuple):
    """(A, J) each: density of the marked azimuth, mean and variance of the slope that is marked there."""

    azimuth_density: Float64Array
    slope_mean: Float64Array
    slope_variance: Float64Array


class HeightErrors(NamedTuple):
    """By raster of the terrain, (L,): variance of heights, and metres from which their errors are independent."""

    variance: Float64Array
    apart: Float64Array


class SmokeDensities(NamedTuple):
    """(A, R) each, filled by the loops: densities with the foot `seen` and `hidden`, and these over the greatest that
    the sample could have; `unseen`: the chance that the terrain hides the foot; `lifts`: metres above the ground from
    which something is seen.
    """

    seen: Float64Array
    hidden: Float64Array
    seen_fit: Float32Array
    hidden_fit: Float32Array
    unseen: Float32Array
    lifts: Float32Array


class Drifts(NamedTuple):
    """Of plumes that drift. `widths`: (A,) of the fan. `density`: (D, A, J), and its greatest (D, J), of the marked
    azimuth by drift. `lean`: sigma of the drift a metre of rise. `next_drift`: (D - 1,) from which the next one counts.
    """

    widths: Float64Array
    density: Float64Array
    peak: Float64Array
    lean: float
    next_drift: Float64Array


class FanSamples(NamedTuple):
    """Of a `SightFan`: `ranges`, `steps`: (R,); `widths`, `sines`, `cosines`: (A,) of its azimuths."""

    ranges: Float64Array
    steps: Float64Array
    widths: Float64Array
    sines: Float64Array
    cosines: Float64Array


class CellSums(NamedTuple):
    """(H, W) each, filled: density times area, area, lift times both, and the best fit."""

    total: Float64Array
    area: Float64Array
    lift: Float64Array
    fit: Float64Array
