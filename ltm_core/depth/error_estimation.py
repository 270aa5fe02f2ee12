"""A network's error model out of what it said where the terrain can be trusted.

First bias and spread by range, over the whole photo; then corrections by region, where they hold on regions that they
were not taken from.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from ltm_core.depth.error_model import FIRST, OCTAVES, ErrorModel, ErrorTables, octaves
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import GroundSamples
from ltm_core.types import Float32Array, Float64Array, IndexArray

REGIONS = (9, 16)
"""Rows and columns in which samples are gathered."""
_FINE = 4  # cells of the tables in one region, each way


def estimate_errors(
    read: Float64Array, samples: GroundSamples, size: tuple[int, int], config: FusionConfig
) -> ErrorModel:
    """From what the network said (N,), 1/m, at ground samples of a photo of `size` (height, width)."""
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
    """Middle of `less` (N,), a part of the true inverse depth, by half octave, and its spread without the terrain's.

    Both are drawn towards those of all samples by a region's worth of belief. Samples side by side are no evidence
    of an error that goes with depth: they may all lie on one hill, or on one thing that stands there since.
    """
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
    """Middle and spread of the densest part of `less` (N,): what stands before the ground in most of the places where
    its range is seen draws a median along, and its own spread into that of the network."""
    ordered = np.sort(less)
    densest = config.error_model.densest
    count = max(2, math.ceil(densest * len(ordered)))
    widths = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    start = int(np.argmin(widths))
    middle = float(np.median(ordered[start : start + count]))
    # Of a normal distribution, that part lies within so many sigmas.
    wide = float(widths[start]) / (2.0 * NormalDist().inv_cdf(0.5 + 0.5 * densest))
    return middle, max(wide**2 - float(np.median(terrain)) ** 2, config.scale.relative_floor**2) ** 0.5


def _by_region(
    off: Float64Array, samples: GroundSamples, size: tuple[int, int], config: FusionConfig
) -> tuple[Float32Array, Float32Array]:
    """Mean of `off` (N,) by region and depth, 0 where that does not help, and the spread about it, (R, C, D).

    Means are taken over the regions of a checkerboard and judged on the others: what they say of ground that they have
    not seen is what they will say of trees.
    """
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
    """The region (N,) that each sample of a photo of `size` is in, row by row."""
    rows = np.minimum(samples.rows * REGIONS[0] // size[0], REGIONS[0] - 1)
    cols = np.minimum(samples.cols * REGIONS[1] // size[1], REGIONS[1] - 1)
    return np.asarray(rows * REGIONS[1] + cols, np.intp)


def _means(
    index: IndexArray, off: Float64Array, belief: float, config: FusionConfig, prior: float = 0.0
) -> Float32Array:
    """Smoothed mean of `off` by region and depth, drawn towards `prior` by as many samples as `belief` says."""
    totals, counts = _sums(index, off - prior, config)
    return np.asarray(prior + totals / (counts + belief), np.float32)


def _sums(index: IndexArray, off: Float64Array, config: FusionConfig) -> tuple[Float64Array, Float64Array]:
    """Smoothed sums and counts by region and depth, of a unit of belief's height: a lone cell still counts with all
    its samples."""
    cells, rules = (*REGIONS, OCTAVES), config.error_model
    totals = np.bincount(index, off, np.prod(cells)).reshape(cells)
    counts = np.bincount(index, minlength=int(np.prod(cells))).reshape(cells).astype(np.float64)
    totals, counts = (
        gaussian_filter(a, rules.blur, mode="nearest", truncate=2.0) / rules.peak for a in (totals, counts)
    )
    return totals, counts


def _grown(table: Float32Array) -> Float32Array:
    """A table (R, C, D) at _FINE times the rows and columns."""
    size = (table.shape[1] * _FINE, table.shape[0] * _FINE)
    return np.ascontiguousarray(cv2.resize(table, size, interpolation=cv2.INTER_LINEAR), np.float32)
