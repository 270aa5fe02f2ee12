"""Axes of maps: round easting and northing coordinates along two sides of a map picture."""

from __future__ import annotations

import math

import cv2
import numpy as np

from ltm_core.grid import GridGeometry
from ltm_core.pictures.legend import INK, PAPER
from ltm_core.pictures.text import Anchor, draw_texts, text_width
from ltm_core.types import RgbImage

_STEPS = (0.5, 1, 2, 5)  # the first for lengths that rounding puts just below a power of ten
_LEAST_TICKS = 3


def with_axes(picture: RgbImage, view: GridGeometry, offset: tuple[float, float] = (0.0, 0.0)) -> RgbImage:
    """`picture` (of the raster `view`) with eastings below and northings on the left, metres, every round distance.

    `offset`: what is added to the view's coordinates, such as the map frame's origin.
    """
    height, width = picture.shape[:2]
    size = max(11, round(width / 68))
    step = round_step(min(width, height) * view.resolution)
    eastings = _ticks(view.x_min + offset[0], view.x_max + offset[0], step)
    northings = _ticks(view.y_min + offset[1], view.y_max + offset[1], step)
    left = max(text_width(_number(n), size) for n in (*northings, 0.0)) + size
    bottom = round(size * 2.1)
    sheet = np.full((height + bottom, width + left, 3), PAPER, np.uint8)
    sheet[:height, left:] = picture
    cv2.rectangle(sheet, (left, 0), (left + width - 1, height - 1), INK, 1)
    texts: list[tuple[str, float, float, Anchor]] = []
    for value in eastings:
        x = left + round((value - offset[0] - view.x_min) / view.resolution)
        cv2.line(sheet, (x, height), (x, height + size // 3), INK, 1)
        half = text_width(_number(value), size) / 2
        texts.append((_number(value), min(max(x, left + half), left + width - half), height + size * 0.5, "mt"))
    for value in northings:
        y = round((view.y_max - value + offset[1]) / view.resolution)
        cv2.line(sheet, (left - size // 3, y), (left, y), INK, 1)
        texts.append((_number(value), left - size * 0.5, min(max(y, size * 0.6), height - size * 0.6), "rm"))
    return draw_texts(sheet, texts, size, INK)


def round_step(length: float) -> float:
    """The greatest of 1, 2, 5 times a power of ten that goes into `length` three times or more."""
    power = 10.0 ** math.floor(math.log10(length / _LEAST_TICKS))
    return max(n * power for n in _STEPS if n * power * _LEAST_TICKS <= length)


def _ticks(low: float, high: float, step: float) -> list[float]:
    return [n * step for n in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _number(value: float) -> str:
    return f"{value:.0f}" if value == round(value) else f"{value:g}"
