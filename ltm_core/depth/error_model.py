"""Model the errors of a depth network, and estimate the model from trusted terrain.

The model states what the network answers, and its noise, if the true depth is known: first bias and spread by range
over the whole photo, then corrections by region if held-out regions confirm them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ltm_core.base.kernels import helper
from ltm_core.base.types import Float32Array, Float64Array, IndexArray, Int32Array
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import GroundSamples

OCTAVES = 28
"""Number of half octaves of depth, starting at 4 m."""
FIRST = 4.5
"""2 log2 of the middle of the first half octave in metres."""
_FARTHEST = 40_000.0
_STEPS = 4096  # of each of three tables of logarithms
_NEAR, _MIDDLE, _FAR = (
    np.clip(2.0 * np.log2((np.arange(_STEPS) + 0.5) * width) - FIRST, 0.0, OCTAVES - 1.001).astype(np.float32)
    for width in (1 / 16, 1.0, 16.0)
)


class ErrorTables(NamedTuple):
    """Compiled form of an `ErrorModel`. `least_said`: minimum of a network's value as a share of the true inverse
    depth."""

    shift: Float32Array
    factor: Float32Array
    least_said: np.float32


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Error model: at true inverse depth x, the network gives x - shift x, with a sigma of factor x. `tables`: both,
    (R, C, D) float32 over the photo and half octaves of depth. `regional`: whether they differ over the photo."""

    tables: ErrorTables
    regional: bool

    @classmethod
    def none(cls) -> ErrorModel:
        """Return the model used without a network."""
        plain = np.zeros((1, 1, OCTAVES), np.float32)
        return cls(ErrorTables(plain, plain + 1, np.float32(1.0)), False)

    def standardized(self, read: Float64Array, samples: GroundSamples, size: tuple[int, int]) -> Float64Array:
        """Return true minus measured inverse depth at samples (N,), in sigmas of both network and terrain."""
        shift, factor, _ = self.tables
        rows = samples.rows * shift.shape[0] // size[0]
        cols = samples.cols * shift.shape[1] // size[1]
        at = rows, cols, octaves(samples.depth)
        off = 1.0 - read * samples.depth - shift[at]
        return np.asarray(off / np.hypot(factor[at], samples.sigma / samples.depth), np.float64)


def octaves(depth: NDArray[np.floating]) -> IndexArray:
    """Return the half octave of each depth in metres."""
    places = np.rint(2.0 * np.log2(depth) - FIRST)
    return np.asarray(np.clip(places, 0, OCTAVES - 1), np.intp)


@helper()
def _place(depth: np.float32) -> np.float32:
    """Return where a depth, metres, lies among the half octaves: a logarithm, looked up, since every pixel asks."""
    if depth < np.float32(_STEPS / 16):
        return np.float32(_NEAR[int(depth * np.float32(16.0))])
    if depth < np.float32(_STEPS):
        return np.float32(_MIDDLE[int(depth)])
    return np.float32(_FAR[min(int(depth * np.float32(1 / 16)), _STEPS - 1)])


@helper()
def expected_prediction(row: int, col: int, inverse: np.float32, tables: ErrorTables) -> tuple[np.float32, np.float32]:
    """Return the bias of the network at the true `inverse` depth in a cell of the tables, and its sigma, 1/m."""
    # What has no depth, as the sky, is taken for the farthest that the tables know.
    inverse = max(inverse, np.float32(1 / _FARTHEST))
    shift, factor = tables.shift, tables.factor
    place = _place(np.float32(1.0) / inverse)
    k = int(place)
    part = place - np.float32(k)
    less = shift[row, col, k] + part * (shift[row, col, k + 1] - shift[row, col, k])
    sigma = factor[row, col, k] + part * (factor[row, col, k + 1] - factor[row, col, k])
    return less * inverse, sigma * inverse


@helper()
def interpolation_table(tables: ErrorTables) -> Float32Array:
    """Return both tables (R, C, D) side by side, (R, C * D, 4): each value, and its difference to the next half
    octave."""
    shift, factor = tables.shift, tables.factor
    rows, cols, count = shift.shape
    both = np.zeros((rows, cols * count, 4), np.float32)
    for i in range(rows):
        for j in range(cols):
            for k in range(count):
                after = min(k + 1, count - 1)
                both[i, j * count + k, 0] = shift[i, j, k]
                both[i, j * count + k, 1] = shift[i, j, after] - shift[i, j, k]
                both[i, j * count + k, 2] = factor[i, j, k]
                both[i, j * count + k, 3] = factor[i, j, after] - factor[i, j, k]
    return both


@helper(fastmath={"nsz", "arcp", "contract"})
def expected_predictions(
    inverse: Float32Array,
    tables: Float32Array,
    col: Int32Array,
    place: Int32Array,
    part: Float32Array,
    less: Float32Array,
    sigma: Float32Array,
) -> None:
    """Compute `expected_prediction` for a row of pixels (W,) into `less` and `sigma`. `tables`: (C * D, 4), one row of
    `interpolation_table`; `col`: (W,) of the tables; `place`, `part`: (W,) work arrays. The logarithm comes from the
    bits: log2(2^e (1 + m)) is e + m + 0.3438 m (1 - m) but for 0.009."""
    least, last = np.float32(1 / _FARTHEST), np.float32(OCTAVES - 1.001)
    for u in range(len(inverse)):
        sigma[u] = inverse[u] if inverse[u] > least else least
    bits = sigma.view(np.int32)
    for u in range(len(inverse)):
        m = np.float32(bits[u] & 0x7FFFFF) * np.float32(2.0**-23)
        log2 = np.float32((bits[u] >> 23) - 127) + m + np.float32(0.3438) * m * (np.float32(1.0) - m)
        at = np.float32(-2.0) * log2 - np.float32(FIRST)
        at = at if at > 0 else np.float32(0.0)
        part[u] = at if at < last else last
    for u in range(len(inverse)):
        place[u] = np.int32(part[u]) + col[u] * np.int32(OCTAVES)
    for u in range(len(inverse)):
        part[u] -= np.float32(np.int32(part[u]))
    for u in range(len(inverse)):
        at, x, more = tables[place[u]], sigma[u], part[u]
        less[u] = (at[0] + more * at[1]) * x
        sigma[u] = (at[2] + more * at[3]) * x


@helper()
def invert(row: int, col: int, read: np.float32, tables: ErrorTables) -> tuple[np.float32, np.float32]:
    """Return the true inverse depth for the network's value `read`, and its sigma, 1/m."""
    plain = np.float32(1.0)
    less, sigma = expected_prediction(row, col, read, tables)
    if read > 0:
        plain = max(plain - less / read, tables.least_said)
    return read / plain, sigma / plain


REGIONS = (9, 16)
"""Rows and columns of the regions in which samples are collected."""
_FINE = 4  # cells of the tables in one region, each way


def estimate_errors(
    read: Float64Array, samples: GroundSamples, size: tuple[int, int], config: FusionConfig
) -> ErrorModel:
    """Estimate a network's errors from its values (N,), 1/m, at ground samples of a photo of `size` (height, width)."""
    rules = config.error_model
    usable = read * samples.depth < rules.nearer
    samples, read = samples.part(usable), read[usable]
    terrain = samples.sigma / samples.depth
    octave = octaves(samples.depth)
    less = 1.0 - read * samples.depth
    usual, spread = _by_depth(octave, less, terrain, _regions(samples, size), config)
    off = (less - usual[octave]) / np.hypot(spread[octave], terrain)
    # What the network sees much nearer than the terrain is cover that no label told of, not its slow error.
    ground = off > -rules.covered
    clipped = np.clip(off, -rules.winsor, rules.winsor)[ground]
    mean, factor = _by_region(clipped, samples.part(ground), size, config)
    shift = usual.astype(np.float32) + _grown(mean) * spread.astype(np.float32)
    tables = ErrorTables(shift, _grown(factor) * spread.astype(np.float32), np.float32(rules.least_said))
    return ErrorModel(tables, bool(mean.any()))


def _by_depth(
    octave: IndexArray, less: Float64Array, terrain: Float64Array, region: IndexArray, config: FusionConfig
) -> tuple[Float64Array, Float64Array]:
    """Return the middle of `less` (N,) by half octave, a share of the true inverse depth, and its spread without the
    terrain's; both are drawn towards those of all samples, because neighbouring samples may all lie on one hill."""
    rules = config.error_model
    middle, wide = _spread(less, terrain, config)
    known, usual, square = [], [], []
    for which in np.unique(octave):
        part = octave == which
        count = int(part.sum())
        if count >= rules.fewest and rules.by_depth:
            here, own = _spread(less[part], terrain[part], config)
            places = len(np.unique(region[part]))
            weight = places / (places + rules.belief)
            known.append(which)
            usual.append(middle + weight * (here - middle))
            # What the belief takes from the middle is left as spread.
            square.append(weight * own**2 + (1 - weight) * (wide**2 + weight * (here - middle) ** 2))
    if not known:
        return np.full(OCTAVES, middle), np.full(OCTAVES, wide)
    every = np.arange(OCTAVES)
    growth = rules.beyond ** np.maximum(every - known[-1], 0) * rules.before ** np.maximum(known[0] - every, 0)
    middles, spread = np.interp(every, known, usual), np.sqrt(np.interp(every, known, square))
    # A network's noise is one of inverse depth: of farther ground it is no greater than of nearer. What is greater is
    # not its own but that of things which stand before the ground, and so is a nearness beyond that.
    depth = 2.0 ** ((every + FIRST) / 2.0)
    noise = np.minimum.accumulate(np.where(every < known[0], np.inf, spread / depth))
    middles = np.maximum(middles, -np.maximum(2.0 * np.append(np.inf, noise[:-1]) * depth, rules.nearer_far))
    most = np.maximum(noise * depth, rules.biased * np.abs(middles))
    return middles, np.maximum(np.minimum(spread, most), rules.least_spread * wide) * growth


def _spread(less: Float64Array, terrain: Float64Array, config: FusionConfig) -> tuple[float, float]:
    """Return the middle and spread of the densest part of `less` (N,): what stands before the ground in most of the
    places where its range is seen draws a median along, and its own spread into that of the network."""
    ordered = np.sort(less)
    densest = config.error_model.densest
    count = max(2, math.ceil(densest * len(ordered)))
    widths = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    start = int(np.argmin(widths))
    middle = float(np.median(ordered[start : start + count]))
    # The number of sigmas that contain this part of a normal distribution.
    wide = float(widths[start]) / (2.0 * NormalDist().inv_cdf(0.5 + 0.5 * densest))
    return middle, max(wide**2 - float(np.median(terrain)) ** 2, config.scale.relative_floor**2) ** 0.5


def _by_region(
    off: Float64Array, samples: GroundSamples, size: tuple[int, int], config: FusionConfig
) -> tuple[Float32Array, Float32Array]:
    """Return the mean of `off` (N,) by region and depth, 0 where held-out regions of a checkerboard do not confirm it,
    and the spread about it, (R, C, D)."""
    rules = config.error_model
    region = _regions(samples, size)
    rows, cols = region // REGIONS[1], region % REGIONS[1]
    index = region * OCTAVES + octaves(samples.depth)
    black = (rows + cols) % 2 == 0
    unseen = float(np.mean(off**2))
    best, shrink = unseen * rules.gain**2, None
    # Both halves are smoothed once; what belief makes of them is a division.
    halves = [(~s, *_sums(index[s], off[s], config)) for s in (black, ~black) if s.any() and not s.all()]
    for belief in rules.shrink if rules.regional else ():
        left = np.concatenate(
            [np.zeros(0), *(off[rest] - (t / (n + belief)).ravel()[index[rest]] for rest, t, n in halves)]
        )
        if len(left) and float(np.mean(left**2)) < best:
            unseen = best = float(np.mean(left**2))
            shrink = belief
    shift = np.zeros((*REGIONS, OCTAVES), np.float32)
    if shrink is not None:
        shift = _means(index, off, shrink, config)
        off = off - shift.ravel()[index]
    # Where no ground was sampled, errors are those of regions that were held out, and more: these lay side by side.
    return shift, np.sqrt(_means(index, off**2, 16.0, config, max(1.0, rules.unsampled * unseen)))


def _regions(samples: GroundSamples, size: tuple[int, int]) -> IndexArray:
    """Return the region (N,) that each sample of a photo of `size` is in, row by row."""
    rows = np.minimum(samples.rows * REGIONS[0] // size[0], REGIONS[0] - 1)
    cols = np.minimum(samples.cols * REGIONS[1] // size[1], REGIONS[1] - 1)
    return np.asarray(rows * REGIONS[1] + cols, np.intp)


def _means(
    index: IndexArray, off: Float64Array, belief: float, config: FusionConfig, prior: float = 0.0
) -> Float32Array:
    """Return the smoothed mean of `off` by region and depth, drawn towards `prior` by as many samples as `belief`
    says."""
    totals, counts = _sums(index, off - prior, config)
    return np.asarray(prior + totals / (counts + belief), np.float32)


def _sums(index: IndexArray, off: Float64Array, config: FusionConfig) -> tuple[Float64Array, Float64Array]:
    """Return the smoothed sums and counts by region and depth, of a unit of belief's height: a lone cell still counts
    with all its samples."""
    cells, rules = (*REGIONS, OCTAVES), config.error_model
    totals = np.bincount(index, off, np.prod(cells)).reshape(cells)
    counts = np.bincount(index, minlength=int(np.prod(cells))).reshape(cells).astype(np.float64)
    totals, counts = (
        gaussian_filter(a, rules.blur, mode="nearest", truncate=2.0) / rules.peak for a in (totals, counts)
    )
    return totals, counts


def _grown(table: Float32Array) -> Float32Array:
    """Return a table (R, C, D) at _FINE times the rows and columns."""
    size = (table.shape[1] * _FINE, table.shape[0] * _FINE)
    return np.ascontiguousarray(cv2.resize(table, size, interpolation=cv2.INTER_LINEAR), np.float32)
