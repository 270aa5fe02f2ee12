"""Score labels and depths against truth."""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, Float64Array, Int64Array, UInt8Array


@dataclass(frozen=True, eq=False)
class SegmentationScore:
    """Pixels by [true class, predicted class]; the last column counts pixels that were left unlabelled. `confusion`:
    (K, K + 1) int64. Pixels whose truth is unknown are not in it. Scores of a class that does not occur in the truth
    (for F1 and IoU: nor in the prediction) are NaN."""

    confusion: Int64Array

    @classmethod
    def empty(cls, classes: int) -> "SegmentationScore":
        return cls(np.zeros((classes, classes + 1), np.int64))

    def plus(self, truth: UInt8Array, predicted: UInt8Array) -> "SegmentationScore":
        """Return the score with one more pair of label images (H, W). Raises ImageError if their shapes differ."""
        if truth.shape != predicted.shape:
            raise ImageError(f"labels of shape {predicted.shape} cannot be scored against truth of {truth.shape}")
        classes = len(self.confusion)
        known = truth < classes
        ids = np.where(predicted[known] < classes, predicted[known], classes).astype(np.int64)
        pairs = truth[known].astype(np.int64) * (classes + 1) + ids
        counts = np.bincount(pairs, minlength=classes * (classes + 1)).reshape(classes, classes + 1)
        return SegmentationScore(self.confusion + counts)

    @property
    def pixels(self) -> int:
        """Return the pixels of known truth."""
        return int(self.confusion.sum())

    @property
    def right(self) -> Int64Array:
        return np.diagonal(self.confusion)

    @property
    def true(self) -> Int64Array:
        """Return (K,) pixels of each class in the truth."""
        return np.asarray(self.confusion.sum(axis=1))

    @property
    def predicted(self) -> Int64Array:
        """Return (K,) pixels given to each class."""
        return np.asarray(self.confusion[:, :-1].sum(axis=0))

    @property
    def iou(self) -> Float64Array:
        """Return (K,) intersection over union."""
        return _ratio(self.right, self.true + self.predicted - self.right)

    @property
    def f1(self) -> Float64Array:
        """Return (K,) harmonic mean of precision and recall."""
        return _ratio(2 * self.right, self.true + self.predicted)

    @property
    def precision(self) -> Float64Array:
        return _ratio(self.right, self.predicted)

    @property
    def recall(self) -> Float64Array:
        return _ratio(self.right, self.true)

    @property
    def accuracy(self) -> float:
        """Return the share of pixels of known truth that are right."""
        return float(_ratio(self.right.sum(), self.confusion.sum()))

    @property
    def unlabelled(self) -> float:
        """Return the share of pixels of known truth that were left unlabelled."""
        return float(_ratio(self.confusion[:, -1].sum(), self.confusion.sum()))

    @property
    def mean_iou(self) -> float:
        """Return the mean IoU over the classes that occur in the truth; NaN where none does."""
        present = self.iou[self.true > 0]
        return float(present.mean()) if present.size else float("nan")

    def macro_f1(self, classes: Iterable[int] | None = None) -> float:
        """Return the mean F1 over those of `classes`, or of all, that occur in the truth; NaN where none does."""
        counted = range(len(self.confusion)) if classes is None else classes
        present = [self.f1[k] for k in counted if self.true[k] > 0]
        return float(np.mean(present)) if present else float("nan")


def _ratio(part: object, whole: object) -> Float64Array:
    part, whole = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    return np.asarray(np.divide(part, whole, out=np.full(part.shape, np.nan), where=whole > 0), np.float64)


BINS = 15
_LEVELS = np.arange(256) / 255.0
_BIN = np.minimum((_LEVELS * BINS).astype(np.int64), BINS - 1)


@dataclass(frozen=True, eq=False)
class CalibrationScore:
    """Labelled pixels of known truth by confidence of 0..255: `pixels` and `wrong`, each (256,) float64."""

    pixels: Float64Array
    wrong: Float64Array

    @classmethod
    def empty(cls) -> "CalibrationScore":
        return cls(np.zeros(256), np.zeros(256))

    def plus(
        self, truth: UInt8Array, predicted: UInt8Array, confidence: UInt8Array, classes: int
    ) -> "CalibrationScore":
        """Add one image: labels (H, W) and confidence x 255. Raises ImageError if shapes differ."""
        if not truth.shape == predicted.shape == confidence.shape:
            raise ImageError(
                f"truth {truth.shape}, labels {predicted.shape} and confidence {confidence.shape} differ in shape"
            )
        known = (truth < classes) & (predicted < classes)
        place = confidence[known]
        wrong = (truth != predicted)[known].astype(np.float64)
        return CalibrationScore(
            self.pixels + np.bincount(place, minlength=256), self.wrong + np.bincount(place, wrong, 256)
        )

    @property
    def ece(self) -> float:
        """Return the expected calibration error (Guo et al. 2017): mean |share right - mean confidence| over bins of
        equal width of confidence, weighted by pixels; NaN without pixels."""
        total = self.pixels.sum()
        if total == 0:
            return float("nan")
        excess = self.pixels - self.wrong - self.pixels * _LEVELS
        return float(np.abs(np.bincount(_BIN, excess, BINS)).sum() / total)

    def risk(self, coverage: float = 1.0) -> float:
        """Return the share of wrong labels among the part `coverage` of the pixels whose confidence is highest
        (El-Yaniv and Wiener 2010); NaN without pixels. Pixels of one confidence are taken to err alike."""
        pixels, wrong = np.cumsum(self.pixels[::-1]), np.cumsum(self.wrong[::-1])
        if pixels[-1] == 0 or coverage <= 0:
            return float("nan")
        wanted = coverage * pixels[-1]
        return float(np.interp(wanted, np.r_[0.0, pixels], np.r_[0.0, wrong]) / wanted)


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


class DepthTally:
    """Errors by range bin of the truth (`RANGE_BINS`)."""

    def __init__(self) -> None:
        self.frames = 0
        self._true = 0
        self._parts = [np.zeros((2, 0), np.float32)]  # true depth and error of the pixels of each frame

    def add(self, estimate: Float32Array, truth: Float32Array) -> None:
        """Count one pair of depth images (H, W), metres; pixels count where both are finite. Raises ImageError on
        different shapes."""
        if estimate.shape != truth.shape:
            raise ImageError(f"depth of {estimate.shape} cannot be scored against truth of {truth.shape}")
        self.frames += 1
        known = np.isfinite(truth)
        self._true += int(known.sum())
        both = known & np.isfinite(estimate)
        self._parts.append(np.stack([truth[both], estimate[both].astype(np.float64) - truth[both]]).astype(np.float32))

    @property
    def coverage(self) -> float:
        """Return the share of pixels of finite true depth for which there was a finite estimate."""
        return sum(part.shape[1] for part in self._parts) / self._true if self._true else float("nan")

    def scores(self) -> list[DepthScore]:
        """Return the scores by range bin, then over all."""
        true, error = np.concatenate(self._parts, axis=1)
        bins = [*itertools.pairwise(RANGE_BINS), (0.0, np.inf)]
        return [_score(near, far, error[(true >= near) & (true < far)].astype(np.float64)) for near, far in bins]


def _score(near: float, far: float, error: Float64Array) -> DepthScore:
    if not len(error):
        return DepthScore(near, far, 0, np.nan, np.nan, np.nan, np.nan)
    size, rmse = np.abs(error), float(np.sqrt((error**2).mean()))
    return DepthScore(near, far, len(error), rmse, float(size.mean()), float(np.median(size)), float(error.mean()))


def at_pixels_of(depth: NDArray[Value], image: tuple[int, int], shape: tuple[int, ...]) -> NDArray[Value]:
    """Return `depth`, or labels, at the pixels that truth of `shape` (h, w) samples of an `image` (H, W): every n-th
    from 0. An array of any other size is taken to cover the same field of view and is read at the nearest pixel. Raises
    ImageError where truth is no such sampling."""
    step = max(1, round(image[1] / shape[1]))
    if (-(-image[0] // step), -(-image[1] // step)) != tuple(shape):
        raise ImageError(f"truth of {shape} is not a sampling of an image of {image}")
    if depth.shape == shape:
        return depth
    if depth.shape == image:
        return depth[::step, ::step]
    rows, cols = (
        np.clip(np.floor((np.arange(count) * step + 0.5) * own / size), 0, own - 1).astype(np.int64)
        for count, size, own in zip(shape, image, depth.shape, strict=True)
    )
    return np.asarray(depth[rows[:, None], cols])
