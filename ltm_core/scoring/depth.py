"""Depth errors against truth by range bin, summed frame by frame in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, Float64Array, Int64Array

Value = TypeVar("Value", bound=np.generic)

RANGE_BINS = (0.0, 100.0, 300.0, 1000.0, np.inf)
"""Edges in metres of true depth of the range bins in which depth is scored."""


@dataclass(frozen=True)
class DepthScore:
    """Errors of one range bin, metres; NaN where no pixel counts."""

    near: float
    far: float
    pixels: int
    rmse: float
    mae: float
    median: float
    """Median absolute error."""
    bias: float
    """Mean of estimate minus truth."""


# Sizes of error, metres, in bins 0.6 % wide: a median read from them is off by less than half of that.
_SMALLEST, _LARGEST, _PER_DECADE = 1e-4, 1e6, 400
_EDGES = np.logspace(-4, 6, 10 * _PER_DECADE + 1)


class DepthTally:
    """Counts, sums and a histogram of errors by range bin of the truth (`edges`, metres).

    `coverage`: the share of pixels whose true depth is finite for which there was a finite estimate.
    """

    def __init__(self, edges: tuple[float, ...] = RANGE_BINS) -> None:
        self.edges = edges
        bins = len(edges) - 1
        self.frames = 0
        self._true = 0
        self._count = np.zeros(bins, np.int64)
        self._sums = np.zeros((3, bins))  # of error, its size, its square
        self._sizes = np.zeros((bins, len(_EDGES) + 1), np.int64)

    def add(self, estimate: Float32Array, truth: Float32Array) -> None:
        """Count one pair of depth images (H, W), metres; pixels count where both are finite.

        Raises ImageError on different shapes.
        """
        if estimate.shape != truth.shape:
            raise ImageError(f"depth of {estimate.shape} cannot be scored against truth of {truth.shape}")
        self.frames += 1
        known = np.isfinite(truth)
        self._true += int(known.sum())
        both = known & np.isfinite(estimate)
        true = truth[both].astype(np.float64)
        error = estimate[both].astype(np.float64) - true
        index = np.digitize(true, self.edges) - 1
        inside = (index >= 0) & (index < len(self._count))
        index, error = index[inside], error[inside]
        size = np.abs(error)
        self._count += np.bincount(index, minlength=len(self._count))
        for row, values in enumerate((error, size, error**2)):
            self._sums[row] += np.bincount(index, values, len(self._count))
        width = self._sizes.shape[1]
        places = index * width + np.digitize(size, _EDGES)
        self._sizes += np.bincount(places, minlength=self._sizes.size).reshape(self._sizes.shape)

    @property
    def coverage(self) -> float:
        return float(self._count.sum() / self._true) if self._true else float("nan")

    def scores(self) -> list[DepthScore]:
        """Return the scores by range bin, then over all."""
        rows = [
            _score(near, far, self._count[i], self._sums[:, i], self._sizes[i])
            for i, (near, far) in enumerate(zip(self.edges[:-1], self.edges[1:], strict=True))
        ]
        whole = _score(
            self.edges[0], self.edges[-1], self._count.sum(), self._sums.sum(axis=1), self._sizes.sum(axis=0)
        )
        return [*rows, whole]


def _score(near: float, far: float, count: np.int64, sums: Float64Array, sizes: Int64Array) -> DepthScore:
    if count == 0:
        return DepthScore(near, far, 0, np.nan, np.nan, np.nan, np.nan)
    bias, mae, square = sums / count
    return DepthScore(near, far, int(count), float(np.sqrt(square)), float(mae), _median(sizes), float(bias))


def _median(sizes: Int64Array) -> float:
    """Return the middle of a histogram over `_EDGES`, placed inside its bin by the share of it that lies below the
    middle."""
    below = np.cumsum(sizes)
    middle = below[-1] / 2
    place = int(np.searchsorted(below, middle))
    before = below[place - 1] if place else 0
    share = (middle - before) / sizes[place]
    if place == 0:
        return float(_SMALLEST * share)
    if place == len(_EDGES):
        return _LARGEST
    low, high = _EDGES[place - 1], _EDGES[place]
    return float(low + share * (high - low))


def at_pixels_of(depth: NDArray[Value], image: tuple[int, int], shape: tuple[int, ...]) -> NDArray[Value]:
    """Return `depth`, or labels, at the pixels that truth of `shape` (h, w) samples of an `image` (H, W): every n-th
    from 0.

    An array of any other size is taken to cover the same field of view and is read at the nearest pixel. Raises
    ImageError where truth is no such sampling.
    """
    step = max(1, round(image[1] / shape[1]))
    if (-(-image[0] // step), -(-image[1] // step)) != tuple(shape):
        raise ImageError(f"truth of {shape} is not a sampling of an image of {image}")
    if depth.shape == shape:
        return depth
    if depth.shape == image:
        return depth[::step, ::step]
    rows = _nearest(np.arange(shape[0]) * step, image[0], depth.shape[0])
    cols = _nearest(np.arange(shape[1]) * step, image[1], depth.shape[1])
    return np.asarray(depth[rows[:, None], cols])


def _nearest(places: Int64Array, size: int, other: int) -> Int64Array:
    """Return the pixels of a row of `other` pixels that lie where `places` lie in one of `size`."""
    return np.asarray(np.clip(np.floor((places + 0.5) * other / size), 0, other - 1), np.int64)
