"""Calibration of confidence: how often labels of a given probability are right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.errors import ImageError
from ltm_core.types import Float64Array, UInt8Array

BINS = 15


@dataclass(frozen=True, eq=False)
class CalibrationScore:
    """Labelled pixels of known truth in bins of confidence (equal widths over 0..1): `pixels`, `right` and the sum of
    `confidence`, each (BINS,) float64."""

    pixels: Float64Array
    right: Float64Array
    confidence: Float64Array

    @classmethod
    def empty(cls) -> CalibrationScore:
        return cls(*(np.zeros(BINS) for _ in range(3)))

    def plus(self, truth: UInt8Array, predicted: UInt8Array, confidence: UInt8Array, classes: int) -> CalibrationScore:
        """With one more image: labels (H, W) and confidence x 255. Raises ImageError where shapes differ."""
        if not truth.shape == predicted.shape == confidence.shape:
            raise ImageError(
                f"truth {truth.shape}, labels {predicted.shape} and confidence {confidence.shape} differ in shape"
            )
        known = (truth < classes) & (predicted < classes)
        probability = confidence[known] / 255.0
        place = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
        right = (truth == predicted)[known].astype(np.float64)
        return CalibrationScore(
            self.pixels + np.bincount(place, minlength=BINS),
            self.right + np.bincount(place, right, BINS),
            self.confidence + np.bincount(place, probability, BINS),
        )

    @property
    def ece(self) -> float:
        """Expected calibration error (Guo et al. 2017): mean |share right - mean confidence| of a bin, weighted by
        pixels; NaN without pixels."""
        total = self.pixels.sum()
        if total == 0:
            return float("nan")
        return float(np.abs(self.right - self.confidence).sum() / total)
