"""Calibration of confidence: how often labels of a given probability are right, and whether it ranks them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float64Array, UInt8Array

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


@dataclass(frozen=True, eq=False)
class RiskCoverage:
    """Labelled pixels of known truth by their confidence of 0..255: `pixels` and `wrong`, each (256,) float64.

    Risk at a coverage is the share of wrong labels among that part of the labelled pixels whose confidence is highest
    (El-Yaniv and Wiener 2010); of pixels of one confidence, each part is taken to err alike.
    """

    pixels: Float64Array
    wrong: Float64Array

    @classmethod
    def empty(cls) -> RiskCoverage:
        return cls(np.zeros(256), np.zeros(256))

    def plus(self, truth: UInt8Array, predicted: UInt8Array, confidence: UInt8Array, classes: int) -> RiskCoverage:
        """With one more image: labels (H, W) and confidence x 255. Raises ImageError where shapes differ."""
        if not truth.shape == predicted.shape == confidence.shape:
            raise ImageError(
                f"truth {truth.shape}, labels {predicted.shape} and confidence {confidence.shape} differ in shape"
            )
        known = (truth < classes) & (predicted < classes)
        place = confidence[known]
        wrong = (truth != predicted)[known].astype(np.float64)
        return RiskCoverage(
            self.pixels + np.bincount(place, minlength=256), self.wrong + np.bincount(place, wrong, 256)
        )

    def risk(self, coverage: float = 1.0) -> float:
        """Share of wrong labels at a coverage of 0..1; NaN without pixels."""
        pixels, wrong = np.cumsum(self.pixels[::-1]), np.cumsum(self.wrong[::-1])
        if pixels[-1] == 0 or coverage <= 0:
            return float("nan")
        wanted = coverage * pixels[-1]
        return float(np.interp(wanted, np.r_[0.0, pixels], np.r_[0.0, wrong]) / wanted)
