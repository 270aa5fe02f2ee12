"""Model the errors of a depth network, and estimate the model from trusted terrain.

The model states what the network answers, and its noise, if the true depth is known: bias and spread by range."""

import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.kernels import helper
from ltm_core.base.types import Float32Array, Float64Array, IndexArray
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import GroundSamples

OCTAVES = 28
"""Number of half octaves of depth, starting at 4 m."""
FIRST = 4.5
"""2 log2 of the middle of the first half octave in metres."""
_FARTHEST = 40_000.0


class ErrorModel(NamedTuple):
    """Error model: at true inverse depth x, the network gives x - shift x, with a sigma of factor x. `shift`, `factor`:
    (D,) float32 by half octave of depth. `least_said`: minimum of a network's value as a share of the true inverse
    depth."""

    shift: Float32Array
    factor: Float32Array
    least_said: np.float32

    @classmethod
    def none(cls) -> "ErrorModel":
        """Return the model used without a network."""
        plain = np.zeros(OCTAVES, np.float32)
        return cls(plain, plain + 1, np.float32(1.0))


def octaves(depth: NDArray[np.floating]) -> IndexArray:
    """Return the half octave of each depth in metres."""
    places = np.rint(2.0 * np.log2(depth) - FIRST)
    return np.asarray(np.clip(places, 0, OCTAVES - 1), np.intp)


@helper()
def expected_prediction(inverse: np.float32, errors: ErrorModel) -> tuple[np.float32, np.float32]:
    """Return the bias of the network at the true `inverse` depth, and its sigma, 1/m."""
    # What has no depth, as the sky, is taken for the farthest that the tables know.
    inverse = max(inverse, np.float32(1 / _FARTHEST))
    shift, factor = errors.shift, errors.factor
    place = np.float32(-2.0) * np.log2(inverse) - np.float32(FIRST)
    place = min(max(place, np.float32(0.0)), np.float32(OCTAVES - 1.001))
    k = int(place)
    part = place - np.float32(k)
    less = shift[k] + part * (shift[k + 1] - shift[k])
    sigma = factor[k] + part * (factor[k + 1] - factor[k])
    return less * inverse, sigma * inverse


@helper()
def invert(read: np.float32, errors: ErrorModel) -> tuple[np.float32, np.float32]:
    """Return the true inverse depth for the network's value `read`, and its sigma, 1/m."""
    plain = np.float32(1.0)
    less, sigma = expected_prediction(read, errors)
    if read > 0:
        plain = max(plain - less / read, errors.least_said)
    return read / plain, sigma / plain


_REGIONS = (9, 16)
"""Rows and columns of the regions of a photo; samples of one may all lie on one hill."""


def estimate_errors(
    read: Float64Array, samples: GroundSamples, size: tuple[int, int], config: FusionConfig
) -> ErrorModel:
    """Estimate a network's errors from its values (N,), 1/m, at ground samples of a photo of `size` (height, width):
    their middle by half octave, a share of the true inverse depth, and their spread without the terrain's; both are
    drawn towards those of all samples by the number of regions in which the half octave was sampled."""
    rules = config.error_model
    octave, less, terrain = octaves(samples.depth), 1.0 - read * samples.depth, samples.sigma / samples.depth
    rows = np.minimum(samples.rows * _REGIONS[0] // size[0], _REGIONS[0] - 1)
    cols = np.minimum(samples.cols * _REGIONS[1] // size[1], _REGIONS[1] - 1)
    region = rows * _REGIONS[1] + cols
    middle, wide = _spread(less, terrain, config)
    known, usual, square = [], [], []
    for which in np.unique(octave):
        part = octave == which
        if int(part.sum()) >= rules.fewest:
            here, own = _spread(less[part], terrain[part], config)
            places = len(np.unique(region[part]))
            weight = places / (places + rules.belief)
            known.append(which)
            usual.append(middle + weight * (here - middle))
            # What the belief takes from the middle is left as spread.
            square.append(weight * own**2 + (1 - weight) * (wide**2 + weight * (here - middle) ** 2))
    middles, spread = np.full(OCTAVES, middle), np.full(OCTAVES, wide)
    if known:
        every = np.arange(OCTAVES)
        middles, spread = np.interp(every, known, usual), np.sqrt(np.interp(every, known, square))
        # A network's noise is one of inverse depth: of farther ground it is no greater than of nearer. What is greater
        # is not its own but that of things which stand before the ground, and so is a nearness beyond that.
        depth = 2.0 ** ((every + FIRST) / 2.0)
        noise = np.minimum.accumulate(np.where(every < known[0], np.inf, spread / depth))
        middles = np.maximum(middles, -np.maximum(2.0 * np.append(np.inf, noise[:-1]) * depth, rules.nearer_far))
        most = np.maximum(noise * depth, rules.biased * np.abs(middles))
        growth = rules.beyond ** np.maximum(every - known[-1], 0) * rules.before ** np.maximum(known[0] - every, 0)
        spread = np.maximum(np.minimum(spread, most), rules.least_spread * wide) * growth
    return ErrorModel(middles.astype(np.float32), spread.astype(np.float32), np.float32(rules.least_said))


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
