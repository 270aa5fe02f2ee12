"""Colours of ranges on a logarithmic scale: near is warm, far is cold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike

from ltm_core.errors import ImageError
from ltm_core.types import Float32Array, RgbImage

SKY_COLOR = (222, 232, 240)
UNKNOWN_COLOR = (70, 70, 74)


@dataclass(frozen=True)
class RangeScale:
    """The ranges, metres, at the two ends of the colour scale; values beyond an end take its colour.

    The default suits a tower camera. It does not follow the image, so that colours mean the same in all pictures.
    """

    near: float = 30.0
    far: float = 30_000.0

    def __post_init__(self) -> None:
        if not (0 < self.near < self.far < math.inf):
            raise ImageError(f"colour scale needs 0 < near < far metres, got near={self.near}, far={self.far}")

    @classmethod
    def of(cls, ranges: ArrayLike) -> RangeScale:
        """The scale from the 0.5th to the 99.5th percentile of the finite ranges, rounded outwards to 1, 2 or 5."""
        values = np.asarray(ranges)
        values = values[np.isfinite(values) & (values > 0)]
        if values.size == 0:
            return cls()
        low, high = np.percentile(values, [0.5, 99.5])
        near = max(t for t in _one_two_five(low / 10, low) if t <= low)
        far = min(t for t in _one_two_five(high, high * 10) if t >= high)
        return cls(near, far if far > near else near * 10)

    def fraction(self, ranges: ArrayLike) -> Float32Array:
        """Place of each range on the scale, 0 near to 1 far; NaN where the range is not a finite positive number."""
        values = np.asarray(ranges, np.float32)
        usable = np.isfinite(values) & (values > 0)
        log = np.log(np.where(usable, values, 1.0))
        span = math.log(self.far) - math.log(self.near)
        placed = np.clip((log - math.log(self.near)) / span, 0.0, 1.0)
        return np.where(usable, placed, np.nan).astype(np.float32)

    def ticks(self) -> list[float]:
        """Round ranges (1, 2, 5 times a power of ten) inside the scale, its ends included where they are round."""
        return [t for t in _one_two_five(self.near, self.far) if self.near <= t <= self.far]


def _one_two_five(low: float, high: float) -> list[float]:
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    return [float(f"{digit}e{power}") for power in range(first, last + 1) for digit in (1, 2, 5)]


@lru_cache(maxsize=1)
def scale_colors() -> RgbImage:
    """(256, 3) colours from near to far: turbo, reversed."""
    ramp = np.arange(255, -1, -1, dtype=np.uint8)[:, None]
    colors = np.ascontiguousarray(cv2.applyColorMap(ramp, cv2.COLORMAP_TURBO)[:, 0, ::-1])
    colors.flags.writeable = False
    return np.asarray(colors, np.uint8)


def depth_colors(
    ranges: ArrayLike,
    scale: RangeScale | None = None,
    sky: tuple[int, int, int] = SKY_COLOR,
    unknown: tuple[int, int, int] = UNKNOWN_COLOR,
) -> RgbImage:
    """Colours (..., 3) of ranges or depths (...) in metres; +inf is sky, NaN (and -inf) unknown."""
    values = np.asarray(ranges, np.float32)
    fraction = (scale or RangeScale()).fraction(values)
    known = np.isfinite(fraction)
    index = np.where(known, fraction * 255, 0).round().astype(np.uint8)
    colors = scale_colors()[index].copy()
    colors[~known] = unknown
    colors[np.isposinf(values)] = sky
    return colors
