"""Correct and withdraw labels by the colour and contrast of the photo.

What a photo's colour says against a class: living crowns show more green than red, dry slopes and rock do not.

A network that learnt dark slopes as forest calls dry chaparral and shaded cliffs *tree*. Its own scores do not tell
them apart, the photo's two strongest channels do. What is taken off is bounded, so that trees of which the network is
sure stay trees under an evening sun, in autumn, and in photos that were graded warm.

Withdraws labels that are better left out: those of low probability, and *tree* where the photo shows no texture.

On real towers hazy far slopes of shrub are called tree, with confidence; what marks them is their contrast. Forests on
mountains have as little of it, so that it speaks against trees only where the picture shows more shrub than tree.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.manifest import Withdrawal


def cie_lab(photo: UInt8Array) -> Float32Array:
    """(H, W, 3) of a photo (H, W, 3) RGB: lightness 0 to 100, a and b about 128."""
    lab = cv2.cvtColor(photo, cv2.COLOR_RGB2LAB).astype(np.float32)
    lab[..., 0] *= np.float32(100 / 255)  # OpenCV stretches it to a byte
    return np.asarray(lab, np.float32)


_GREEN: Final = -0.01
"""Redness up to which nothing is taken off,"""
_RED: Final = 0.03
"""and from which on all is. Chosen with the amounts in the manifest on 166 photos of mountains that taught the network
shipped and on renderings; figures of the tower views were visible meanwhile (docs/labels.md)."""
_REACH: Final = 2 / 320
"""Of the photo's width, standard deviation of the Gaussian that colours are averaged by: noise is no colour."""
_DARK: Final = 4.0
"""Grey levels added to the sum: in black, colour says nothing."""


def redness(image: UInt8Array, rows: int, cols: int) -> Float32Array:
    """(rows, cols) of a photo (H, W, 3) RGB: red minus green over their sum; 0 where they are alike."""
    small = cv2.resize(image, (cols, rows), interpolation=cv2.INTER_AREA).astype(np.float32)
    soft = cv2.GaussianBlur(small, (0, 0), _REACH * cols)
    red, green = soft[..., 0], soft[..., 1]
    return np.asarray((red - green) / (red + green + _DARK), np.float32)


def against_green(image: UInt8Array, rows: int, cols: int) -> Float32Array:
    """(rows, cols) in 0..1: how much a photo (H, W, 3) RGB speaks against what is green."""
    return np.asarray(np.clip((redness(image, rows, cols) - _GREEN) / (_RED - _GREEN), 0.0, 1.0), np.float32)


_WIDTH = 640  # pixels that the photo is brought to, so that contrast means the same for each camera
_WINDOW = 15  # pixels of these


def withdraw(image: UInt8Array, labels: UInt8Array, confidence: UInt8Array, rules: Withdrawal) -> None:
    """Set labels (H, W) that the rules withdraw to 255, and their confidence to 0, in place; `image` (H, W, 3)."""
    if not rules.any:
        return
    out = confidence < np.uint8(round(255 * rules.confidence))
    if rules.tree_contrast > 0:
        trees = labels == Label.TREE
        if 0 < np.count_nonzero(trees) < np.count_nonzero(labels == Label.SHRUB):
            low = (contrast(image) < rules.tree_contrast).astype(np.uint8)
            height, width = labels.shape
            out |= trees & (cv2.resize(low, (width, height), interpolation=cv2.INTER_NEAREST) > 0)
    labels[out] = UNLABELLED
    confidence[out] = 0


def contrast(image: UInt8Array) -> Float32Array:
    """Standard deviation of grey within 15 pixels, in 8-bit steps, of the photo at a width of 640 (h, 640) float32."""
    height, width = image.shape[:2]
    rows = max(1, round(height * _WIDTH / width))
    method = cv2.INTER_AREA if width > _WIDTH else cv2.INTER_LINEAR
    grey = cv2.cvtColor(cv2.resize(image, (_WIDTH, rows), interpolation=method), cv2.COLOR_RGB2GRAY).astype(np.float32)
    mean, square = (cv2.boxFilter(v, -1, (_WINDOW, _WINDOW)) for v in (grey, grey * grey))
    return np.asarray(np.sqrt(np.maximum(square - mean * mean, 0.0)), np.float32)
