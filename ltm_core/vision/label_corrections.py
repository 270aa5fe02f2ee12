"""Colour as a person tells it apart: CIE Lab, in which a distance of 1 is hardly seen."""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.base.types import Float32Array, UInt8Array


def cie_lab(photo: UInt8Array) -> Float32Array:
    """(H, W, 3) of a photo (H, W, 3) RGB: lightness 0 to 100, a and b about 128."""
    lab = cv2.cvtColor(photo, cv2.COLOR_RGB2LAB).astype(np.float32)
    lab[..., 0] *= np.float32(100 / 255)  # OpenCV stretches it to a byte
    return np.asarray(lab, np.float32)
