"""Calibration of confidence: how often labels of a given probability are right, and how well it ranks them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float64Array, UInt8Array

BINS = 15
_LEVELS = np.arange(256) / 255.0
_BIN = np.minimum((_LEVELS * BINS).astype(np.int64), BINS - 1)


@dataclass(frozen=True, eq=False)
class CalibrationScore:
    """Labelled pixels of known truth by confidence of 0..255: `pixels` and `wrong`, each (256,) float64."""

    pixels: Float64Array
    wrong: Float64Array

    @classmethod
    def empty(cls) -> CalibrationScore:
        return cls(np.zeros(256), np.zeros(256))

    def plus(self, truth: UInt8Array, predicted: UInt8Array, confidence: UInt8Array, classes: int) -> CalibrationScore:
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
        """Expected calibration error (Guo et al. 2017): mean |share right - mean confidence| over bins of equal width
        of confidence, weighted by pixels; NaN without pixels."""
        total = self.pixels.sum()
        if total == 0:
            return float("nan")
        excess = self.pixels - self.wrong - self.pixels * _LEVELS
        return float(np.abs(np.bincount(_BIN, excess, BINS)).sum() / total)

    def risk(self, coverage: float = 1.0) -> float:
        """Share of wrong labels among the part `coverage` of the pixels whose confidence is highest (El-Yaniv and
        Wiener 2010); NaN without pixels. Pixels of one confidence are taken to err alike."""
        pixels, wrong = np.cumsum(self.pixels[::-1]), np.cumsum(self.wrong[::-1])
        if pixels[-1] == 0 or coverage <= 0:
            return float("nan")
        wanted = coverage * pixels[-1]
        return float(np.interp(wanted, np.r_[0.0, pixels], np.r_[0.0, wrong]) / wanted)
