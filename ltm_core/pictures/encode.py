"""Encodes RGB arrays as JPEG or PNG bytes."""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.errors import ImageError
from ltm_core.types import RgbImage


def to_jpeg(picture: RgbImage, quality: int = 85) -> bytes:
    """JPEG of a photo-like picture (H, W, 3). Raises ImageError on another shape or dtype."""
    return _encode(picture, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1])


def to_png(picture: RgbImage) -> bytes:
    """PNG of a drawing (H, W, 3), lossless. Raises ImageError on another shape or dtype."""
    # Of 9. A map takes a third of the processor time that it takes at 6, and 5 % more bytes.
    return _encode(picture, ".png", [cv2.IMWRITE_PNG_COMPRESSION, 3])


def _encode(picture: RgbImage, suffix: str, options: list[int]) -> bytes:
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or picture.size == 0:
        raise ImageError(f"a picture must be (H, W, 3) uint8 RGB, got {picture.shape} {picture.dtype}")
    done, data = cv2.imencode(suffix, np.ascontiguousarray(picture[..., ::-1]), options)
    if not done:
        raise ImageError(f"OpenCV could not write a picture of {picture.shape} as {suffix}")
    return bytes(data)
