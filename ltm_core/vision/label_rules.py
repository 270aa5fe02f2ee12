"""Correct, withdraw and calibrate a network's labels by colour, terrain, contrast, neighbours and probability.

- Colour: living crowns show more green than red, dry slopes and rock do not. A network that learnt dark slopes as
  forest calls dry chaparral and shaded cliffs *tree*. The correction of the scores is bounded, so that trees of which
  the network is sure stay trees under an evening sun, in autumn, and in photos that were graded warm.
- Terrain: labels that the terrain makes unlikely, such as sky on ground, need a higher probability.
- Withdrawal: labels of low probability are removed, and *tree* where the photo shows no texture. Hazy far slopes of
  shrub are called tree with confidence, but have little contrast. Forests on mountains have as little, so that
  contrast counts against trees only in a photo with more shrub than tree.
- Agreement: a label is right more often than its probability says where the pixels around it have the same label.
  Patches within another class, and edges between classes, are what label heads get wrong."""

import math
from typing import Final

import cv2
import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.manifest import Withdrawal
from ltm_core.vision.network_image import WORKING_WIDTH, working_image


def cie_lab(photo: UInt8Array) -> Float32Array:
    """Convert a photo (H, W, 3) RGB to CIE Lab (H, W, 3): lightness 0 to 100, a and b about 128."""
    lab = cv2.cvtColor(photo, cv2.COLOR_RGB2LAB).astype(np.float32)
    lab[..., 0] *= np.float32(100 / 255)  # OpenCV stretches it to a byte
    return np.asarray(lab, np.float32)


_GREEN: Final = -0.01  # redness up to which nothing is subtracted
_RED: Final = 0.03
"""Redness above which the full amount is subtracted. Both were chosen, with the amounts in the manifest, on 166
mountain photos that trained the shipped network and on renderings; scores of the tower views were visible meanwhile
(docs/labels.md)."""
_REACH: Final = 2 / 320  # sigma of the Gaussian for averaging colours, share of the width; it suppresses noise
_DARK: Final = 4.0  # grey levels added to the sum, because colour carries no information in dark areas


def against_green(image: UInt8Array, rows: int, cols: int) -> Float32Array:
    """Return (rows, cols) in 0..1: evidence of a photo (H, W, 3) RGB against green vegetation, by its redness, red
    minus green over their sum."""
    small = cv2.resize(image, (cols, rows), interpolation=cv2.INTER_AREA).astype(np.float32)
    red, green, _ = cv2.split(cv2.GaussianBlur(small, (0, 0), _REACH * cols))
    redness = (red - green) / (red + green + _DARK)
    return np.asarray(np.clip((redness - _GREEN) / (_RED - _GREEN), 0.0, 1.0), np.float32)


_WINDOW = 13  # pixels of the working image


def withdraw(image: UInt8Array, labels: UInt8Array, confidence: UInt8Array, rules: Withdrawal) -> None:
    """Set labels (H, W) that the rules withdraw to 255, and their confidence to 0, in place; `image` (H, W, 3)."""
    height, width = labels.shape
    parts = []
    if rules.confidence > 0:
        parts.append(cv2.compare(confidence, round(255 * rules.confidence), cv2.CMP_LT))
    if rules.tree_contrast > 0:
        trees, shrubs = (cv2.compare(labels, int(label), cv2.CMP_EQ) for label in (Label.TREE, Label.SHRUB))
        if 0 < cv2.countNonZero(trees) < cv2.countNonZero(shrubs):
            low = np.where(contrast(image) < rules.tree_contrast, np.uint8(UNLABELLED), np.uint8(0))
            rows, columns = (np.arange(n) * of // n for n, of in zip((height, width), low.shape, strict=True))
            parts.append(cv2.bitwise_and(trees, low.take(columns, 1).take(rows, 0)))  # `cv2.resize` takes twice as long
    for gone in parts:
        cv2.bitwise_or(labels, gone, dst=labels)
        cv2.bitwise_and(confidence, cv2.bitwise_not(gone, dst=gone), dst=confidence)


def contrast(image: UInt8Array) -> Float32Array:
    """Return (h, 512) float32, the standard deviation of grey within 13 pixels of the photo at a width of 512."""
    height, width = image.shape[:2]
    small = working_image(image)
    if width < WORKING_WIDTH:  # contrast must mean the same for each camera
        small = cv2.resize(image, (WORKING_WIDTH, max(1, round(height * WORKING_WIDTH / width))))
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.float32)
    mean, square = (cv2.boxFilter(v, -1, (_WINDOW, _WINDOW)) for v in (grey, grey * grey))
    return np.asarray(np.sqrt(np.maximum(square - mean * mean, 0.0)), np.float32)


_UNLIKELY: Final = math.exp(-3.0)
"""Factor of the odds of a label that the terrain makes unlikely. Of LANDFIRE's water at most 0.3 % lies on slopes (see
`WATER_STEEPEST_DEG`), of the land 40 to 63 %, which would give exp(-5). With exp(-3), a network that is surer than 0.95
of the sky keeps it, so that a camera which turned unnoticed still shows its skyline."""


def less_likely(probabilities: Float32Array, label: int, where: BoolArray) -> None:
    """Lower the odds of a label of probabilities (K, h, w), in place, at pixels `where` (rows, columns)."""
    size = probabilities.shape[:0:-1]
    chosen = cv2.resize(where.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    factor = np.where(chosen, np.float32(_UNLIKELY), np.float32(1))
    total = 1 + probabilities[label] * (factor - 1)
    probabilities[label] *= factor
    probabilities /= total


class LabelAgreement(StrictModel):
    """Confidence by local agreement. `reach`: standard deviation of the Gaussian around a pixel as a share of the
    image's width; 0: only the pixel itself. `exponent`: makes the mean the share of right labels, as measured."""

    reach: float = Field(default=0.0, ge=0, le=0.1)
    exponent: float = Field(default=1.0, gt=0, le=5)


def agreed(probabilities: Float32Array, rule: LabelAgreement) -> Float32Array:
    """Return (h, w) confidence of the most likely of (K, h, w) probabilities: the mean around the pixel of its
    probability where the same class is the most likely, 0 elsewhere, to the exponent."""
    winner, best = probabilities.argmax(axis=0), probabilities.max(axis=0)
    sigma = rule.reach * probabilities.shape[2]
    mean = np.zeros(best.shape, np.float32)
    for k in np.unique(winner):
        own = winner == k
        around = cv2.GaussianBlur(np.where(own, best, np.float32(0)), (0, 0), sigma)
        mean[own] = around[own]
    return np.asarray(np.clip(mean, 0, 1) ** np.float32(rule.exponent), np.float32)


class Calibration(StrictModel):
    """Label errors of a label head: `confusion[i][j]` is P(label j given | label i true), classes in the order of
    `labels.yaml`; `measured_on` names the data, and `photographs` the number of real photos (None: unknown)."""

    classes: tuple[str, ...]
    confusion: tuple[tuple[float, ...], ...]
    measured_on: str
    photographs: int | None = Field(default=None, ge=0)
    ece: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _rows_are_distributions(self) -> "Calibration":
        count = len(self.classes)
        if len(self.confusion) != count or any(len(row) != count for row in self.confusion):
            raise ValueError(f"confusion must have {count} rows of {count} values, one for each of classes")
        for name, row in zip(self.classes, self.confusion, strict=True):
            if min(row) < 0 or abs(sum(row) - 1.0) > 1e-2:
                raise ValueError(f"confusion: the row of {name} sums to {sum(row):.4f}, expected 1, none below 0")
        return self
