"""Legend of the height tints of a terrain map."""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.dem import Dem
from ltm_core.pictures.legend import INK, PAPER
from ltm_core.pictures.relief import hypsometric
from ltm_core.pictures.text import Anchor, draw_texts
from ltm_core.types import RgbImage


def height_legend(dem: Dem, width: int) -> RgbImage:
    """The tints that `terrain_colors` gives this DEM, with their heights in metres, (h, `width`, 3)."""
    size = max(11, min(22, round(width / 60)))
    known = dem.elevation[np.isfinite(dem.elevation)]
    low, high = (float(v) for v in np.percentile(known, [1, 99]))
    strip = np.full((round(size * 3.2), width, 3), PAPER, np.uint8)
    left, right, top, bar = size * 2, width - size * 3, size // 2, size
    heights = np.linspace(low, high, right - left, dtype=np.float32)[None]
    strip[top : top + bar, left:right] = hypsometric(heights, low, high)
    texts: list[tuple[str, float, float, Anchor]] = []
    for height in _round_steps(low, high):
        x = left + (height - low) / max(high - low, 1e-3) * (right - left - 1)
        cv2.line(strip, (round(x), top + bar), (round(x), top + bar + size // 3), INK, 1)
        texts.append((f"{height:,.0f} m", x, top + bar + size * 0.5, "mt"))
    return draw_texts(strip, texts, size, INK)


def _round_steps(low: float, high: float) -> list[float]:
    """Heights of a round distance between the two, four to ten of them."""
    span = max(high - low, 1e-3)
    power = 10.0 ** np.floor(np.log10(span))
    step = next(s for s in (power / 5, power / 2, power, power * 2) if span / s <= 10)
    return [float(h) for h in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step]
