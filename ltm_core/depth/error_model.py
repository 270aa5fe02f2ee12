"""What a network answers where the true depth is known: its slow errors and its noise, by region and by depth.

The question that fusion asks of every pixel is not how far off the network usually is, but what it would say *here* if
the terrain were right. A network that takes all far hills for nearer ones does not contradict a far hill; one that sees
them so everywhere but at one spot does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ltm_core.depth.ground_sampling import GroundSamples
from ltm_core.types import Float32Array, Float64Array, IndexArray, Int32Array

REGIONS = (9, 16)
"""Rows and columns in which samples are gathered."""
RELATIVE_FLOOR = 2e-3
"""Least relative noise that is believed."""
UNSAMPLED = 4.0
"""Variance of a region without samples, in that of regions held out."""
OCTAVES = 28
"""Half octaves of depth, from 4 m on."""
_FIRST, _FARTHEST = 4.5, 40_000.0  # 2 log2 of the first half octave's middle; metres
_FINE = 4  # cells of the tables in one region, each way
_SHRINK = (4.0, 16.0, 64.0)  # samples' worth of belief in no correction, tried in turn
_GAIN = 0.97  # of the held-out error: corrections that do not reach it are left out
_WINSOR = 6.0
_COVERED = 4.0
_BLUR = (1.0, 1.0, 1.5)
_PEAK = 0.15  # about what a smoothed cell keeps of its own
_STEPS = 4096  # of each of three tables of logarithms
_NEAR, _MIDDLE, _FAR = (
    np.clip(2.0 * np.log2((np.arange(_STEPS) + 0.5) * width) - _FIRST, 0.0, OCTAVES - 1.001).astype(np.float32)
    for width in (1 / 16, 1.0, 16.0)
)
_LEAST_SAID = 0.25  # of the true inverse depth that a network is taken to say
_FEWEST = 10  # samples of which a spread is taken
_BELIEF = 1.0  # regions' worth of it in that of all
_DENSEST = 0.4  # of the samples, that lie closest together
_DENSEST_SIGMAS = 0.5 / 0.5244  # over their width: a normal distribution's 40 % lie within 0.5244 to each side
_LEAST_SPREAD = 0.5  # of that of all
_NEARER = 12.0  # times nearer than the ground: no error of a network, but something right before the camera
_NEARER_FAR = 3.0  # times nearer and more: far ground that a network knows no range of is seen at some middling one
_BIASED = 0.3  # of a range's error, by which that differs within the half octave
_BEYOND = 1.5  # growth of the spread with each half octave beyond all samples
_BEFORE = 1.1  # the same before all samples: nearness scales, so that a network knows it by what is farther


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Where the true inverse depth is x, the network says x - shift x, with a sigma of factor x.

    `shift`, `factor`: (R, C, D) float32 over the photo and half octaves of depth. `regional`: whether they differ over
    the photo.
    """

    shift: Float32Array
    factor: Float32Array
    regional: bool

    @classmethod
    def of(cls, read: Float64Array, samples: GroundSamples, size: tuple[int, int]) -> ErrorModel:
        """From what the network said (N,), 1/m, at ground samples of a photo of `size` (height, width)."""
        usable = read * samples.depth < _NEARER
        samples, read = samples.part(usable), read[usable]
        terrain = samples.sigma / samples.depth
        octave = octaves(samples.depth)
        less = 1.0 - read * samples.depth
        usual, spread = _by_depth(octave, less, terrain, _regions(samples, size))
        off = (less - usual[octave]) / np.hypot(spread[octave], terrain)
        # What the network sees much nearer than the terrain is cover that no label told of, not its slow error.
        ground = off > -_COVERED
        mean, factor = _by_region(np.clip(off, -_WINSOR, _WINSOR)[ground], samples.part(ground), size)
        shift = usual.astype(np.float32) + _grown(mean) * spread.astype(np.float32)
        return cls(shift, _grown(factor) * spread.astype(np.float32), bool(mean.any()))

    @classmethod
    def none(cls) -> ErrorModel:
        """In place of a network that is not there."""
        plain = np.zeros((1, 1, OCTAVES), np.float32)
        return cls(plain, plain + 1, False)

    def standardized(self, read: Float64Array, samples: GroundSamples, size: tuple[int, int]) -> Float64Array:
        """True less read inverse depth at samples (N,), in sigmas of both network and terrain."""
        rows = samples.rows * self.shift.shape[0] // size[0]
        cols = samples.cols * self.shift.shape[1] // size[1]
        at = rows, cols, octaves(samples.depth)
        off = 1.0 - read * samples.depth - self.shift[at]
        return np.asarray(off / np.hypot(self.factor[at], samples.sigma / samples.depth), np.float64)


def octaves(depth: NDArray[np.floating]) -> IndexArray:
    """The half octave that each depth, metres, is in."""
    places = np.rint(2.0 * np.log2(depth) - _FIRST)
    return np.asarray(np.clip(places, 0, OCTAVES - 1), np.intp)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _place(depth: np.float32) -> np.float32:
    """Where a depth, metres, lies among the half octaves: a logarithm, looked up, since every pixel asks."""
    if depth < np.float32(_STEPS / 16):
        return np.float32(_NEAR[int(depth * np.float32(16.0))])
    if depth < np.float32(_STEPS):
        return np.float32(_MIDDLE[int(depth)])
    return np.float32(_FAR[min(int(depth * np.float32(1 / 16)), _STEPS - 1)])


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def expected_prediction(
    row: int, col: int, inverse: np.float32, shift: Float32Array, factor: Float32Array
) -> tuple[np.float32, np.float32]:
    """By how much less than the true `inverse` depth the network says in a cell of the tables, and its sigma, 1/m."""
    # What has no depth, as the sky, is taken for the farthest that the tables know.
    inverse = max(inverse, np.float32(1 / _FARTHEST))
    place = _place(np.float32(1.0) / inverse)
    k = int(place)
    part = place - np.float32(k)
    less = shift[row, col, k] + part * (shift[row, col, k + 1] - shift[row, col, k])
    sigma = factor[row, col, k] + part * (factor[row, col, k + 1] - factor[row, col, k])
    return less * inverse, sigma * inverse


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def interpolation_table(shift: Float32Array, factor: Float32Array) -> Float32Array:
    """Both tables (R, C, D) side by side, (R, C * D, 4): each value, and by how much the next half octave's is more."""
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


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def expected_predictions(
    inverse: Float32Array,
    tables: Float32Array,
    col: Int32Array,
    place: Int32Array,
    part: Float32Array,
    less: Float32Array,
    sigma: Float32Array,
) -> None:
    """`expected_prediction` for a row of pixels (W,), into `less` and `sigma`. `tables`: (C * D, 4) one row of
    `interpolation_table`; `col`: (W,) of the tables; `place`, `part`: (W,), to work in.

    The logarithm is taken from the numbers' own bits, so that no table is looked up: log2(2^e (1 + m)) is
    e + m + 0.3438 m (1 - m) but for 0.009.
    """
    least, last = np.float32(1 / _FARTHEST), np.float32(OCTAVES - 1.001)
    for u in range(len(inverse)):
        sigma[u] = inverse[u] if inverse[u] > least else least
    bits = sigma.view(np.int32)
    for u in range(len(inverse)):
        m = np.float32(bits[u] & 0x7FFFFF) * np.float32(2.0**-23)
        log2 = np.float32((bits[u] >> 23) - 127) + m + np.float32(0.3438) * m * (np.float32(1.0) - m)
        at = np.float32(-2.0) * log2 - np.float32(_FIRST)
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


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def invert(
    row: int, col: int, read: np.float32, shift: Float32Array, factor: Float32Array
) -> tuple[np.float32, np.float32]:
    """The true inverse depth that the network means where it says `read`, and its sigma, 1/m."""
    plain = np.float32(1.0)
    less, sigma = expected_prediction(row, col, read, shift, factor)
    if read > 0:
        plain = max(plain - less / read, np.float32(_LEAST_SAID))
    return read / plain, sigma / plain


def _by_depth(
    octave: IndexArray, less: Float64Array, terrain: Float64Array, region: IndexArray
) -> tuple[Float64Array, Float64Array]:
    """Middle of `less` (N,), a part of the true inverse depth, by half octave, and its spread without the terrain's.

    Both are drawn towards those of all samples by a region's worth of belief. Samples side by side are no evidence
    of an error that goes with depth: they may all lie on one hill, or on one thing that stands there since.
    """
    middle, wide = _spread(less, terrain)
    known, usual, square = [], [], []
    for which in np.unique(octave):
        part = octave == which
        count = int(part.sum())
        if count >= _FEWEST:
            here, own = _spread(less[part], terrain[part])
            places = len(np.unique(region[part]))
            weight = places / (places + _BELIEF)
            known.append(which)
            usual.append(middle + weight * (here - middle))
            # What the belief takes from the middle is left as spread.
            square.append(weight * own**2 + (1 - weight) * (wide**2 + weight * (here - middle) ** 2))
    if not known:
        return np.full(OCTAVES, middle), np.full(OCTAVES, wide)
    every = np.arange(OCTAVES)
    growth = _BEYOND ** np.maximum(every - known[-1], 0) * _BEFORE ** np.maximum(known[0] - every, 0)
    middles, spread = np.interp(every, known, usual), np.sqrt(np.interp(every, known, square))
    # A network's noise is one of inverse depth: of farther ground it is no greater than of nearer. What is greater is
    # not its own but that of things which stand before the ground, and so is a nearness beyond that.
    depth = 2.0 ** ((every + _FIRST) / 2.0)
    noise = np.minimum.accumulate(np.where(every < known[0], np.inf, spread / depth))
    middles = np.maximum(middles, -np.maximum(2.0 * np.append(np.inf, noise[:-1]) * depth, _NEARER_FAR))
    most = np.maximum(noise * depth, _BIASED * np.abs(middles))
    return middles, np.maximum(np.minimum(spread, most), _LEAST_SPREAD * wide) * growth


def _spread(less: Float64Array, terrain: Float64Array) -> tuple[float, float]:
    """Middle and spread of the densest part of `less` (N,): what stands before the ground in most of the places where
    its range is seen draws a median along, and its own spread into that of the network."""
    ordered = np.sort(less)
    count = max(2, math.ceil(_DENSEST * len(ordered)))
    widths = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    start = int(np.argmin(widths))
    middle = float(np.median(ordered[start : start + count]))
    wide = _DENSEST_SIGMAS * float(widths[start])
    return middle, max(wide**2 - float(np.median(terrain)) ** 2, RELATIVE_FLOOR**2) ** 0.5


def _by_region(off: Float64Array, samples: GroundSamples, size: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
    """Mean of `off` (N,) by region and depth, 0 where that does not help, and the spread about it, (R, C, D).

    Means are taken over the regions of a checkerboard and judged on the others: what they say of ground that they have
    not seen is what they will say of trees.
    """
    region = _regions(samples, size)
    rows, cols = region // REGIONS[1], region % REGIONS[1]
    index = region * OCTAVES + octaves(samples.depth)
    black = (rows + cols) % 2 == 0
    unseen = float(np.mean(off**2))
    best, shrink = unseen * _GAIN**2, None
    # Both halves are smoothed once; what belief makes of them is a division.
    halves = [(~s, *_sums(index[s], off[s])) for s in (black, ~black) if s.any() and not s.all()]
    for belief in _SHRINK:
        left = np.concatenate(
            [np.zeros(0), *(off[rest] - (t / (n + belief)).ravel()[index[rest]] for rest, t, n in halves)]
        )
        if len(left) and float(np.mean(left**2)) < best:
            unseen = best = float(np.mean(left**2))
            shrink = belief
    shift = np.zeros((*REGIONS, OCTAVES), np.float32)
    if shrink is not None:
        shift = _means(index, off, shrink)
        off = off - shift.ravel()[index]
    # Where no ground was sampled, errors are those of regions that were held out, and more: these lay side by side.
    return shift, np.sqrt(_means(index, off**2, 16.0, max(1.0, UNSAMPLED * unseen)))


def _regions(samples: GroundSamples, size: tuple[int, int]) -> IndexArray:
    """The region (N,) that each sample of a photo of `size` is in, row by row."""
    rows = np.minimum(samples.rows * REGIONS[0] // size[0], REGIONS[0] - 1)
    cols = np.minimum(samples.cols * REGIONS[1] // size[1], REGIONS[1] - 1)
    return np.asarray(rows * REGIONS[1] + cols, np.intp)


def _means(index: IndexArray, off: Float64Array, belief: float, prior: float = 0.0) -> Float32Array:
    """Smoothed mean of `off` by region and depth, drawn towards `prior` by as many samples as `belief` says."""
    totals, counts = _sums(index, off - prior)
    return np.asarray(prior + totals / (counts + belief), np.float32)


def _sums(index: IndexArray, off: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Smoothed sums and counts by region and depth, of a unit of belief's height: a lone cell still counts with all
    its samples."""
    cells = (*REGIONS, OCTAVES)
    totals = np.bincount(index, off, np.prod(cells)).reshape(cells)
    counts = np.bincount(index, minlength=int(np.prod(cells))).reshape(cells).astype(np.float64)
    totals, counts = (gaussian_filter(a, _BLUR, mode="nearest", truncate=2.0) / _PEAK for a in (totals, counts))
    return totals, counts


def _grown(table: Float32Array) -> Float32Array:
    """A table (R, C, D) at _FINE times the rows and columns."""
    size = (table.shape[1] * _FINE, table.shape[0] * _FINE)
    return np.ascontiguousarray(cv2.resize(table, size, interpolation=cv2.INTER_LINEAR), np.float32)
