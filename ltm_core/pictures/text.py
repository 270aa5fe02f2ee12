"""Text in pictures, drawn with Pillow's own scalable font."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ltm_core.types import RgbImage

Anchor = Literal["lt", "mt", "rt", "lm", "mm", "rm", "lb", "mb", "rb"]


@lru_cache(maxsize=32)
def font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def text_width(text: str, size: float) -> int:
    """Pixels that `text` takes in a row."""
    return int(np.ceil(font(size).getlength(text)))


def draw_texts(
    picture: RgbImage,
    texts: list[tuple[str, float, float, Anchor]],
    size: float,
    color: tuple[int, int, int],
    halo: tuple[int, int, int] | None = None,
) -> RgbImage:
    """`picture` with each (text, x, y, anchor) written on it; `halo`: colour of an outline that keeps it legible."""
    canvas = Image.fromarray(picture)
    draw = ImageDraw.Draw(canvas)
    for text, x, y, anchor in texts:
        draw.text(
            (x, y),
            text,
            fill=color,
            font=font(size),
            anchor=anchor,
            stroke_width=max(1, round(size / 8)) if halo else 0,
            stroke_fill=halo,
        )
    return np.asarray(canvas, np.uint8)


def metres(value: float) -> str:
    """A range as people write it: 500 m, 2 km."""
    return f"{value / 1000:g} km" if value >= 1000 else f"{value:g} m"
