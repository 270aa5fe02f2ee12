"""Withdraws labels that are better left out: those of low probability, and *tree* where the photo shows no texture.

On real towers hazy far slopes of shrub are called tree, with confidence; what marks them is their contrast. Forests on
mountains have as little of it, so that it speaks against trees only where the picture shows more shrub than tree.
"""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.types import Float32Array, UInt8Array
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.manifest import Withdrawal

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
