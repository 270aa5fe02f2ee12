"""Colours of absolute depth errors on a logarithmic scale, with their legend."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from ltm_core.pictures.legend import ramp_legend
from ltm_core.pictures.ranges import SKY_COLOR
from ltm_core.types import Float64Array, RgbImage

SMALLEST, LARGEST = 0.3, 300.0
"""Metres at the two ends of the scale."""
_TICKS = (0.3, 1, 3, 10, 30, 100, 300)
_UNKNOWN = (190, 192, 196)


def error_colors(estimate: ArrayLike, truth: ArrayLike) -> RgbImage:
    """|estimate - truth| (H, W) in metres as colours (H, W, 3): dark small, bright large.

    Sky in both is sky; where the one has a depth and the other has none, grey.
    """
    a, b = np.asarray(estimate, np.float32), np.asarray(truth, np.float32)
    known = np.isfinite(a) & np.isfinite(b)
    size = np.abs(np.where(known, a, 0) - np.where(known, b, 0))
    colors = _ramp()[(255 * _place(size)).round().astype(np.uint8)].copy()
    colors[~known] = _UNKNOWN
    colors[np.isposinf(a) & np.isposinf(b)] = SKY_COLOR
    return colors


def error_legend(width: int) -> RgbImage:
    """The colour scale with its ticks and what is not on it, (h, `width`, 3): as high as that of ranges."""
    ticks = [(tick, float(_place(np.float32(tick)))) for tick in _TICKS]
    return ramp_legend(width, _ramp(), ticks, [("in one only", _UNKNOWN), ("sky", SKY_COLOR)])


def _place(size: ArrayLike) -> Float64Array:
    span = np.log(LARGEST / SMALLEST)
    return np.asarray(np.clip(np.log(np.maximum(size, 1e-6) / SMALLEST) / span, 0, 1))


def _ramp() -> RgbImage:
    ramp = np.arange(256, dtype=np.uint8)[:, None]
    return np.asarray(cv2.applyColorMap(ramp, cv2.COLORMAP_INFERNO)[:, 0, ::-1], np.uint8)
