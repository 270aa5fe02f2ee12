"""Draw text and legends; colour ranges and errors on logarithmic scales; encode pictures."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, RgbImage
from ltm_core.vision.labels import LabelSet

UNLABELLED = 255


@dataclass(frozen=True)
class Palette:
    """Names and RGB colours of classes."""

    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]


ClassPalette = LabelSet | Palette
"""Class names and their RGB colours, indexed by class id."""
Anchor = Literal["lt", "mt", "rt", "lm", "mm", "rm", "lb", "mb", "rb"]
Text = tuple[str, float, float, Anchor]  # a text, the pixel (x, y) of its anchor, and which of its points that is
Color = tuple[int, int, int]


@lru_cache(maxsize=32)
def font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def text_width(text: str, size: float) -> int:
    """Return the pixels that `text` takes in a row."""
    return int(np.ceil(font(size).getlength(text)))


def draw_texts(
    picture: RgbImage, texts: Sequence[Text], size: float, color: Color, halo: Color | None = None
) -> RgbImage:
    """Return `picture` with each (text, x, y, anchor) written on it; `halo`: colour of a legible outline."""
    canvas = Image.fromarray(picture)
    draw, stroke = ImageDraw.Draw(canvas), max(1, round(size / 8)) if halo else 0
    for text, x, y, anchor in texts:
        draw.text((x, y), text, color, font(size), anchor, stroke_width=stroke, stroke_fill=halo)
    return np.array(canvas, np.uint8)


def apart(texts: Sequence[Text], size: float, height: int) -> list[Text]:
    """Return the texts, each moved up or down by whole lines until it covers none before it, in `height` rows."""
    line, boxes, placed = size * 1.3, list[tuple[float, float, float, float]](), list[Text]()

    def free(left: float, top: float, right: float) -> bool:
        beside = (left >= x1 or x0 >= right or top >= y1 or y0 >= top + line for x0, y0, x1, y1 in boxes)
        return 0 <= top <= height - line and all(beside)

    for text, x, y, anchor in texts:
        width = text_width(text, size) if text else 0
        left = x - {"l": 0.0, "m": 0.5, "r": 1.0}[anchor[0]] * width
        top = y - {"t": 0.0, "m": 0.5, "b": 1.0}[anchor[1]] * line
        moves = (k * line for k in sorted(range(-12, 13), key=lambda k: (abs(k), -k)))
        move = next((m for m in moves if text and free(left, top + m, left + width)), 0.0)
        if text:
            boxes.append((left, top + move, left + width, top + move + line))
        placed.append((text, x, y + move, anchor))
    return placed


def metres(value: float) -> str:
    """Return a range as people write it: 500 m, 2 km."""
    return f"{value / 1000:g} km" if value >= 1000 else f"{value:g} m"


def to_jpeg(picture: RgbImage, quality: int = 85) -> bytes:
    """JPEG of a photo-like picture (H, W, 3). Raises ImageError on another shape or dtype."""
    return _encode(picture, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1])


def to_png(picture: RgbImage) -> bytes:
    """PNG of a drawing (H, W, 3), lossless. Raises ImageError on another shape or dtype."""
    return _encode(picture, ".png", [])  # OpenCV's choice takes a third of the processor time of any stated level


def _encode(picture: RgbImage, suffix: str, options: list[int]) -> bytes:
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or picture.size == 0:
        raise ImageError(f"an image must be (H, W, 3) uint8 RGB, got {picture.shape} {picture.dtype}")
    done, data = cv2.imencode(suffix, np.ascontiguousarray(picture[..., ::-1]), options)
    if not done:
        raise ImageError(f"OpenCV could not write an image of {picture.shape} as {suffix}")
    return bytes(data)


SKY_COLOR = (222, 232, 240)
UNKNOWN_COLOR = (70, 70, 74)


@dataclass(frozen=True)
class RangeScale:
    """Ranges in metres at the two ends of the colour scale. The default suits a tower camera, and is fixed."""

    near: float = 30.0
    far: float = 30_000.0

    @classmethod
    def of(cls, ranges: ArrayLike) -> "RangeScale":
        """Return the scale of the 0.5th to 99.5th percentile of finite ranges, rounded outwards to 1, 2 or 5."""
        values = np.asarray(ranges)
        values = values[np.isfinite(values) & (values > 0)]
        if values.size == 0:
            return cls()
        low, high = np.percentile(values, [0.5, 99.5])
        near = max(t for t in one_two_five(low / 10, low) if t <= low)
        far = min(t for t in one_two_five(high, high * 10) if t >= high)
        return cls(near, far if far > near else near * 10)

    def fraction(self, ranges: ArrayLike) -> Float32Array:
        """Return the place of each range on the scale, 0 near to 1 far; NaN if it is not finite and positive."""
        values = np.asarray(ranges, np.float32)
        usable = np.isfinite(values) & (values > 0)
        placed = np.log(np.where(usable, values, self.near) / self.near) / math.log(self.far / self.near)
        return np.where(usable, np.clip(placed, 0.0, 1.0), np.nan).astype(np.float32)

    def ticks(self) -> list[float]:
        """Return the round ranges (1, 2, 5 times a power of ten) inside the scale."""
        return [t for t in one_two_five(self.near, self.far) if self.near <= t <= self.far]


def one_two_five(low: float, high: float) -> list[float]:
    """Return 1, 2 and 5 times the powers of ten from about `low` to about `high`."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    return [float(f"{digit}e{power}") for power in range(first, last + 1) for digit in (1, 2, 5)]


def color_map(kind: int) -> RgbImage:
    """Return the (256, 3) RGB colours of one of OpenCV's colour maps, dark to bright."""
    ramp = np.arange(256, dtype=np.uint8)[:, None]
    return np.asarray(cv2.applyColorMap(ramp, kind)[:, 0, ::-1], np.uint8)


@lru_cache(maxsize=1)
def scale_colors() -> RgbImage:
    """Return (256, 3) colours from near to far: viridis from bright to dark, in order for colour-blind eyes too."""
    return color_map(cv2.COLORMAP_VIRIDIS)[::-1]


def depth_colors(ranges: ArrayLike, scale: RangeScale | None = None) -> RgbImage:
    """Return the colours (..., 3) of ranges or depths (...) in metres; +inf is sky, NaN (and -inf) unknown."""
    values = np.asarray(ranges, np.float32)
    fraction = (scale or RangeScale()).fraction(values)
    colors = np.array([*scale_colors(), UNKNOWN_COLOR, SKY_COLOR], np.uint8)
    index = np.where(np.isfinite(fraction), fraction * 255, 256).round()
    return colors.take(np.where(np.isposinf(values), 257, index).astype(np.intp), axis=0)


PAPER = (250, 250, 249)
INK = (38, 40, 44)


def range_legend(width: int, scale: RangeScale | None = None, sky: bool = True) -> RgbImage:
    """Return the colour scale with its round ranges, (h, `width`, 3); `sky`: also the colours without a range."""
    scale = scale or RangeScale()
    ticks = [(metres(tick), float(scale.fraction(tick))) for tick in scale.ticks()]
    others = [("unknown", UNKNOWN_COLOR), ("sky", SKY_COLOR)] if sky else []
    return ramp_legend(width, scale_colors(), ticks, others)


def ramp_legend(
    width: int, ramp: RgbImage, ticks: Sequence[tuple[str, float]], others: Sequence[tuple[str, Color]] = ()
) -> RgbImage:
    """Return a strip (h, `width`, 3): colours `ramp` (256, 3), `ticks` (name, 0 to 1), and what is not on it."""
    size = _text_size(width)
    height, bar = round(size * 3.4), round(size * 1.1)
    strip = np.full((height, width, 3), PAPER, np.uint8)
    widths = [max(round(size * 3), text_width(name, size)) for name, _ in others]
    left, right = round(size * 1.8), width - round(size * 1.8) - sum(other + size for other in widths)
    right -= size if others else 0
    top = round(size * 0.5)
    shown = ramp[np.linspace(0, 255, max(right - left, 2)).round().astype(int)]
    strip[top : top + bar, left : left + len(shown)] = shown
    texts: list[Text] = []
    end = -math.inf
    for tick, place in ticks:
        x = left + place * (right - left)
        cv2.line(strip, (round(x), top + bar), (round(x), top + bar + size // 3), INK, 1)
        half = text_width(tick, size) / 2
        if x - half > end + size * 0.5 and x + half < right + size * 1.7:
            texts.append((tick, x, top + bar + size * 0.5, "mt"))
            end = x + half
    x = right + 2 * size
    for (name, color), other in zip(others, widths, strict=True):
        strip[top : top + bar, x : x + other] = color
        cv2.rectangle(strip, (x, top), (x + other, top + bar - 1), INK, 1)
        texts.append((name, x + other / 2, top + bar + size * 0.5, "mt"))
        x += other + size
    return draw_texts(strip, texts, size, INK)


def label_legend(width: int, label_set: ClassPalette, ids: Iterable[int] | None = None) -> RgbImage:
    """Return a swatch and name for each class in `ids` (default: all), in rows as needed, (h, `width`, 3)."""
    shown = range(len(label_set.names)) if ids is None else sorted(set(ids) & set(range(len(label_set.names))))
    size = _text_size(width)
    swatch, row_height = round(size * 1.1), round(size * 1.9)
    places: list[tuple[int, int, int]] = []
    x, y = size, size // 2
    for label in shown:
        step = swatch + round(size * 1.9) + text_width(label_set.names[label], size)
        if x + step > width and x > size:
            x, y = size, y + row_height
        places.append((label, x, y))
        x += step
    strip = np.full((y + row_height, width, 3), PAPER, np.uint8)
    texts: list[Text] = []
    for label, x, y in places:
        for fill, line in ((label_set.colors[label], -1), (INK, 1)):
            cv2.rectangle(strip, (x, y), (x + swatch, y + swatch), fill, line)
        texts.append((label_set.names[label], x + swatch + size * 0.5, y + swatch / 2, "lm"))
    return draw_texts(strip, texts, size, INK)


def with_legend(picture: RgbImage, *legends: RgbImage) -> RgbImage:
    """Return `picture` with strips of the same width under it."""
    return np.concatenate([picture, *legends], axis=0)


def _text_size(width: int) -> int:
    return max(11, min(26, round(width / 52)))


_UNKNOWN = (190, 192, 196)
_ERRORS = RangeScale(0.3, 300.0)


def error_colors(estimate: ArrayLike, truth: ArrayLike) -> RgbImage:
    """Return |estimate - truth| (H, W) in metres as colours (H, W, 3): dark small, bright large; sky if both are sky,
    grey if only one has a depth."""
    a, b = np.asarray(estimate, np.float32), np.asarray(truth, np.float32)
    known = np.isfinite(a) & np.isfinite(b)
    size = np.abs(np.where(known, a, 0) - np.where(known, b, 0))
    place = (255 * _ERRORS.fraction(np.maximum(size, _ERRORS.near))).round().astype(np.uint8)
    colors = color_map(cv2.COLORMAP_INFERNO)[place]
    colors[~known] = _UNKNOWN
    colors[np.isposinf(a) & np.isposinf(b)] = SKY_COLOR
    return colors


def error_legend(width: int) -> RgbImage:
    """Return the colour scale with its ticks and what is not on it, (h, `width`, 3): as high as that of ranges."""
    places = [(metres(tick), float(_ERRORS.fraction(tick))) for tick in (0.3, 1, 3, 10, 30, 100, 300)]
    return ramp_legend(width, color_map(cv2.COLORMAP_INFERNO), places, [("in one only", _UNKNOWN), ("sky", SKY_COLOR)])
