"""Draw axes around maps, and arrange titled pictures on a sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import RgbImage
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import INK, PAPER, Text, draw_texts, text_width

_STEPS = (0.5, 1, 2, 5)  # the first for lengths that rounding puts just below a power of ten
_LEAST_TICKS = 3


def with_axes(picture: RgbImage, view: GridGeometry, offset: tuple[float, float] = (0.0, 0.0)) -> RgbImage:
    """Return `picture` (of the raster `view`) with eastings below and northings on the left, in metres, every round
    distance. `offset`: added to the view's coordinates."""
    height, width = picture.shape[:2]
    size = max(14, round(width / 54))
    step = round_step(min(width, height) * view.resolution)
    eastings = _ticks(view.x_min + offset[0], view.x_max + offset[0], step)
    northings = _ticks(view.y_min + offset[1], view.y_max + offset[1], step)
    left = max(text_width(_number(n), size) for n in (*northings, 0.0)) + size
    bottom = round(size * 2.1)
    sheet = np.full((height + bottom, width + left, 3), PAPER, np.uint8)
    sheet[:height, left:] = picture
    cv2.rectangle(sheet, (left, 0), (left + width - 1, height - 1), INK, 1)
    texts: list[Text] = [("m N", left - size * 0.5, height + size * 0.5, "rt")]
    for value in eastings:
        x = left + round((value - offset[0] - view.x_min) / view.resolution)
        cv2.line(sheet, (x, height), (x, height + size // 3), INK, 1)
        name = _number(value) + " m E" * (value == eastings[-1])
        half = text_width(name, size) / 2
        texts.append((name, min(max(x, left + half), left + width - half), height + size * 0.5, "mt"))
    for value in northings:
        y = round((view.y_max - value + offset[1]) / view.resolution)
        cv2.line(sheet, (left - size // 3, y), (left, y), INK, 1)
        texts.append((_number(value), left - size * 0.5, min(max(y, size * 0.6), height - size * 0.6), "rm"))
    return draw_texts(sheet, texts, size, INK)


def round_step(length: float) -> float:
    """Return the greatest of 1, 2, 5 times a power of ten that goes into `length` three times or more."""
    power = 10.0 ** math.floor(math.log10(length / _LEAST_TICKS))
    return max(n * power for n in _STEPS if n * power * _LEAST_TICKS <= length)


def _ticks(low: float, high: float, step: float) -> list[float]:
    return [n * step for n in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _number(value: float) -> str:
    return f"{value:.0f}" if value == round(value) else f"{value:g}"


def fit(picture: RgbImage, width: int) -> RgbImage:
    """Return `picture` at `width` pixels, its proportions kept."""
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    if (height, width) == picture.shape[:2]:
        return picture
    method = cv2.INTER_AREA if width < picture.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(picture, (width, height), interpolation=method), np.uint8)


def panel(pictures: Sequence[tuple[str, RgbImage]], columns: int = 2, width: int = 800, heading: str = "") -> RgbImage:
    """Return a sheet of titled pictures, row by row, each `width` pixels wide, under its heading. Raises ImageError
    when there is none."""
    if not pictures or columns < 1:
        raise ImageError(f"a panel needs at least one image and one column, got {len(pictures)} and {columns}")
    size, gap = max(14, round(width / 46)), 14
    title = round(size * 1.8)
    columns = min(columns, len(pictures))
    whole = gap + columns * (width + gap)
    lines = _wrapped(heading, size, whole - 2 * gap)
    fitted = [(name, fit(picture, width)) for name, picture in pictures]
    rows = [fitted[i : i + columns] for i in range(0, len(fitted), columns)]
    heights = [title + max(p.shape[0] for _, p in row) for row in rows]
    y = gap + len(lines) * title
    sheet = np.full((y + sum(h + gap for h in heights), whole, 3), PAPER, np.uint8)
    texts: list[Text] = [(line, gap, gap + (n + 0.5) * title, "lm") for n, line in enumerate(lines)]
    for row, height in zip(rows, heights, strict=True):
        for column, (name, picture) in enumerate(row):
            x = gap + column * (width + gap)
            sheet[y + title : y + title + picture.shape[0], x : x + width] = picture
            texts.append((name, x, y + title * 0.45, "lm"))
        y += height + gap
    return draw_texts(sheet, texts, size, INK)


def _wrapped(text: str, size: float, width: float) -> list[str]:
    """Return the lines of a text that fit a width in pixels."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and text_width(longer, size) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines
