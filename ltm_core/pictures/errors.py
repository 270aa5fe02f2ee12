"""Sizes of depth errors as colours on a logarithmic scale."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ltm_core.pictures.legend import INK, PAPER
from ltm_core.pictures.ranges import SKY_COLOR
from ltm_core.pictures.text import Anchor, draw_texts, metres
from ltm_core.pictures.types import Rgb

SMALLEST, LARGEST = 0.3, 300.0
"""Metres at the two ends of the scale."""
_TICKS = (0.3, 1, 3, 10, 30, 100, 300)
_UNKNOWN = (190, 192, 196)


def error_colors(estimate: ArrayLike, truth: ArrayLike) -> Rgb:
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


def error_legend(width: int) -> Rgb:
    """The colour scale with its ticks, (h, `width`, 3)."""
    size = max(11, min(22, round(width / 60)))
    strip = np.full((round(size * 3.2), width, 3), PAPER, np.uint8)
    left, right, top, bar = size * 2, width - size * 2, size // 2, size
    ramp = _ramp()[np.linspace(0, 255, right - left).round().astype(int)]
    strip[top : top + bar, left:right] = ramp
    texts: list[tuple[str, float, float, Anchor]] = []
    for tick in _TICKS:
        x = left + float(_place(np.float32(tick))) * (right - left - 1)
        cv2.line(strip, (round(x), top + bar), (round(x), top + bar + size // 3), INK, 1)
        texts.append((metres(tick), x, top + bar + size * 0.5, "mt"))
    return draw_texts(strip, texts, size, INK)


def _place(size: ArrayLike) -> NDArray[np.float64]:
    span = np.log(LARGEST / SMALLEST)
    return np.asarray(np.clip(np.log(np.maximum(size, 1e-6) / SMALLEST) / span, 0, 1))


def _ramp() -> Rgb:
    ramp = np.arange(256, dtype=np.uint8)[:, None]
    return np.asarray(cv2.applyColorMap(ramp, cv2.COLORMAP_INFERNO)[:, 0, ::-1], np.uint8)
