"""What a photo's colour says against a class: living crowns show more green than red, dry slopes and rock do not.

A network that learnt dark slopes as forest calls dry chaparral and shaded cliffs *tree*. Its own scores do not tell
them apart, the photo's two strongest channels do. What is taken off is bounded, so that trees of which the network is
sure stay trees under an evening sun, in autumn, and in photos that were graded warm.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from ltm_core.types import Float32Array, UInt8Array

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
