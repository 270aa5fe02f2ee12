"""Legends of colour scales and classes, as strips that go under a picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import cv2
import numpy as np

from ltm_core.pictures.class_palette import ClassPalette
from ltm_core.pictures.ranges import SKY_COLOR, UNKNOWN_COLOR, RangeScale, scale_colors
from ltm_core.pictures.text import draw_texts, metres, text_width
from ltm_core.types import RgbImage

Color = tuple[int, int, int]
PAPER = (250, 250, 249)
INK = (38, 40, 44)


def range_legend(width: int, scale: RangeScale | None = None, sky: bool = True) -> RgbImage:
    """The colour scale with its round ranges, (h, `width`, 3); with `sky` also the colours of what has no range."""
    scale = scale or RangeScale()
    ticks = [(tick, float(scale.fraction(tick))) for tick in scale.ticks()]
    others = [("unknown", UNKNOWN_COLOR), ("sky", SKY_COLOR)] if sky else []
    return ramp_legend(width, scale_colors(), ticks, others)


def ramp_legend(
    width: int, ramp: RgbImage, ticks: Sequence[tuple[float, float]], others: Sequence[tuple[str, Color]] = ()
) -> RgbImage:
    """A strip (h, `width`, 3) with the colours `ramp` (256, 3), its `ticks` (metres, where between 0 and 1), and the
    colours of what is not on the scale.
    """
    size = _text_size(width)
    height, bar = round(size * 3.4), round(size * 1.1)
    strip = _paper(height, width)
    widths = [max(round(size * 3), text_width(name, size)) for name, _ in others]
    left, right = round(size * 1.8), width - round(size * 1.8) - sum(other + size for other in widths)
    right -= size if others else 0
    top = round(size * 0.5)
    shown = ramp[np.linspace(0, 255, max(right - left, 2)).round().astype(int)]
    strip[top : top + bar, left : left + len(shown)] = shown
    texts: list[tuple[str, float, float]] = []
    end = -float("inf")
    for tick, place in ticks:
        x = left + place * (right - left)
        cv2.line(strip, (round(x), top + bar), (round(x), top + bar + size // 3), INK, 1)
        half = text_width(metres(tick), size) / 2
        if x - half > end + size * 0.5 and x + half < right + size * 1.7:
            texts.append((metres(tick), x, top + bar + size * 0.5))
            end = x + half
    x = right + 2 * size
    for (name, color), other in zip(others, widths, strict=True):
        strip[top : top + bar, x : x + other] = color
        cv2.rectangle(strip, (x, top), (x + other, top + bar - 1), INK, 1)
        texts.append((name, x + other / 2, top + bar + size * 0.5))
        x += other + size
    return draw_texts(strip, [(text, x, y, "mt") for text, x, y in texts], size, INK)


def label_legend(width: int, label_set: ClassPalette, ids: Iterable[int] | None = None) -> RgbImage:
    """A swatch and name for each class in `ids` (default: all), in as many rows as the width asks, (h, `width`, 3)."""
    shown = sorted(set(ids)) if ids is not None else range(len(label_set.names))
    size = _text_size(width)
    swatch, row_height = round(size * 1.1), round(size * 1.9)
    places: list[tuple[int, int, int]] = []
    x, row = size, 0
    for label in shown:
        if not 0 <= label < len(label_set.names):
            continue
        step = swatch + round(size * 0.5) + text_width(str(label_set.names[label]), size) + round(size * 1.4)
        if x + step > width and x > size:
            x, row = size, row + 1
        places.append((label, x, row))
        x += step
    strip = _paper((row + 1) * row_height + size // 2, width)
    texts: list[tuple[str, float, float]] = []
    for label, x, row in places:
        y = row * row_height + size // 2
        color = tuple(int(c) for c in np.asarray(label_set.colors[label]))
        cv2.rectangle(strip, (x, y), (x + swatch, y + swatch), color, -1)
        cv2.rectangle(strip, (x, y), (x + swatch, y + swatch), INK, 1)
        texts.append((str(label_set.names[label]), x + swatch + size * 0.5, y + swatch / 2))
    return draw_texts(strip, [(text, x, y, "lm") for text, x, y in texts], size, INK)


def with_legend(picture: RgbImage, *legends: RgbImage) -> RgbImage:
    """`picture` with strips of the same width under it."""
    return np.concatenate([picture, *legends], axis=0)


def _text_size(width: int) -> int:
    return max(11, min(26, round(width / 52)))


def _paper(height: int, width: int) -> RgbImage:
    return np.full((height, width, 3), PAPER, np.uint8)
