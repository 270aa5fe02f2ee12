"""Arranges several titled pictures on one sheet."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ltm_core.errors import ImageError
from ltm_core.pictures.legend import INK, PAPER
from ltm_core.pictures.text import draw_texts
from ltm_core.types import RgbImage


def fit(picture: RgbImage, width: int) -> RgbImage:
    """`picture` at `width` pixels, its proportions kept."""
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    if (height, width) == picture.shape[:2]:
        return picture
    method = cv2.INTER_AREA if width < picture.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(picture, (width, height), interpolation=method), np.uint8)


def panel(pictures: Sequence[tuple[str, RgbImage]], columns: int = 2, width: int = 800, gap: int = 14) -> RgbImage:
    """A sheet of titled pictures, row by row, each `width` pixels wide. Raises ImageError when there is none."""
    if not pictures or columns < 1:
        raise ImageError(f"a panel needs at least one picture and one column, got {len(pictures)} and {columns}")
    size = max(13, round(width / 42))
    title = round(size * 1.8)
    columns = min(columns, len(pictures))
    fitted = [(name, fit(picture, width)) for name, picture in pictures]
    rows = [fitted[i : i + columns] for i in range(0, len(fitted), columns)]
    heights = [title + max(p.shape[0] for _, p in row) for row in rows]
    sheet = np.full((gap + sum(h + gap for h in heights), gap + columns * (width + gap), 3), PAPER, np.uint8)
    texts: list[tuple[str, float, float]] = []
    y = gap
    for row, height in zip(rows, heights, strict=True):
        for column, (name, picture) in enumerate(row):
            x = gap + column * (width + gap)
            sheet[y + title : y + title + picture.shape[0], x : x + width] = picture
            texts.append((name, x, y + title * 0.45))
        y += height + gap
    return draw_texts(sheet, [(text, x, y, "lm") for text, x, y in texts], size, INK)
