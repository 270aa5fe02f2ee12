"""Draws a DEM in 3D as a block seen obliquely from above, in parallel projection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Float32Array, RgbImage
from ltm_core.pictures.drawing import Anchor, draw_texts
from ltm_core.pictures.legend import INK, PAPER
from ltm_core.raster.dem import Dem

_WALL = np.array([150, 138, 124], np.float32)
_FINER = 2  # pixels a side are drawn at, and then averaged


@dataclass(frozen=True)
class Pin:
    """A marked place on the block: map x, y, and height, metres."""

    name: str
    position: tuple[float, float, float]


@dataclass(frozen=True)
class BlockView:
    """From where a block is seen. `azimuth_deg`: the direction looked into; `tilt_deg`: down from the horizon."""

    azimuth_deg: float = 330.0
    tilt_deg: float = 32.0
    exaggeration: float = 1.5

    def __post_init__(self) -> None:
        if not 5 <= self.tilt_deg <= 85 or self.exaggeration <= 0:
            raise ImageError(
                f"a block is seen at 5 to 85 degrees and with heights times more than 0, got {self.tilt_deg} and "
                f"{self.exaggeration}"
            )


def block_picture(
    dem: Dem, colors: RgbImage, view: BlockView | None = None, pins: Sequence[Pin] = (), width: int = 1400
) -> RgbImage:
    """The DEM with `colors` (its shape, RGB) on top, walls down to its lowest height, and pins, (h, `width`, 3).

    Every pixel is found exactly: along a column of the picture the ground comes towards the viewer from far to near,
    so the running maximum of its height in the picture tells what is seen. Raises ImageError on colours of another
    shape.
    """
    view = view or BlockView()
    if colors.shape != (*dem.elevation.shape, 3):
        raise ImageError(f"colours of {colors.shape} do not fit a DEM of {dem.elevation.shape}")
    block = _Block(dem, view, width * _FINER)
    rows, cols, wall = block.hits()
    drawn = cv2.remap(colors, cols, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    drawn[wall] = block.wall_colors()[wall]
    drawn[~np.isfinite(rows)] = PAPER
    height = drawn.shape[0] // _FINER
    picture = cv2.resize(drawn[: height * _FINER], (width, height), interpolation=cv2.INTER_AREA)
    return _pinned(np.clip(picture, 0, 255).round().astype(np.uint8), block, pins)


class _Block:
    """The geometry of one view: places along each column of the picture, near to far."""

    def __init__(self, dem: Dem, view: BlockView, width: int) -> None:
        azimuth, tilt = np.deg2rad([view.azimuth_deg, view.tilt_deg])
        self._ahead = np.array([np.sin(azimuth), np.cos(azimuth)])
        self._right = np.array([np.cos(azimuth), -np.sin(azimuth)])
        self._sin, self._cos = np.sin(tilt), np.cos(tilt) * view.exaggeration
        grid = dem.geometry
        x_min, y_min, x_max, y_max = grid.bounds
        half = grid.resolution / 2
        # Cell centres are the outermost places with a height.
        corners = np.array([[x, y] for x in (x_min + half, x_max - half) for y in (y_min + half, y_max - half)])
        self._centre = corners.mean(axis=0)
        across, along = (corners - self._centre) @ self._right, (corners - self._centre) @ self._ahead
        margin = 0.04 * (across.max() - across.min())
        self._left = across.min() - margin
        self._pixel = (across.max() - across.min() + 2 * margin) / width
        self._steps = np.arange(along.min(), along.max(), min(grid.resolution, self._pixel * 2) / 2)
        known = dem.elevation[np.isfinite(dem.elevation)]
        self._floor = float(known.min()) - 0.12 * float(np.ptp(known)) - 0.02 * (x_max - x_min) / view.exaggeration
        columns = self._left + (np.arange(width) + 0.5) * self._pixel
        places = (
            self._centre
            + columns[:, None, None] * self._right
            + self._steps[None, :, None] * self._ahead
        )  # fmt: skip
        row, col = grid.to_grid(places[..., 0], places[..., 1])
        self._row, self._col = row.astype(np.float32), col.astype(np.float32)
        heights = cv2.remap(
            dem.elevation, self._col, self._row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
        )
        inside = (row >= 0) & (col >= 0) & (row <= grid.height - 1) & (col <= grid.width - 1) & np.isfinite(heights)
        self._level = np.where(inside, self._steps * self._sin + heights * self._cos, -np.inf)
        self._first = np.argmax(inside, axis=1)
        self._any = inside.any(axis=1)
        front = self._steps[self._first] * self._sin
        self._foot = np.where(self._any, front + self._floor * self._cos, np.inf)
        self._lip = np.where(self._any, self._level[np.arange(width), self._first], -np.inf)
        top = self._level.max() + margin
        bottom = self._foot.min() - margin
        self._top = float(top)
        self._levels = top - (np.arange(int((top - bottom) / self._pixel)) + 0.5) * self._pixel
        self._shape = dem.elevation.shape

    def hits(self) -> tuple[Float32Array, Float32Array, BoolArray]:
        """DEM row and column (h, w) that each pixel shows, NaN none; and which pixels show a wall."""
        size = (len(self._levels), len(self._first))
        rows, cols = np.full(size, np.nan, np.float32), np.full(size, np.nan, np.float32)
        highest = np.maximum.accumulate(self._level, axis=1)
        for column in np.flatnonzero(self._any):
            place = np.searchsorted(highest[column], self._levels)
            shown = (place < highest.shape[1]) & (self._levels >= self._foot[column])
            rows[shown, column] = self._row[column, place[shown]]
            cols[shown, column] = self._col[column, place[shown]]
        wall = (self._levels[:, None] < self._lip) & (self._levels[:, None] >= self._foot) & self._any
        return rows, cols, wall

    def wall_colors(self) -> Float32Array:
        """(h, w, 3): each side of the block in a tone of its own, darker towards the foot."""
        index = np.arange(len(self._first))
        row, col = self._row[index, self._first], self._col[index, self._first]
        height, width = self._shape
        sides = np.stack([row, height - 1 - row, col, width - 1 - col])
        tone = np.array([1.0, 0.92, 0.78, 1.1], np.float32)[np.argmin(np.abs(sides), axis=0)]
        depth = (self._levels[:, None] - self._foot) / np.maximum(self._lip - self._foot, 1e-6)
        light = tone * (0.72 + 0.28 * np.clip(np.nan_to_num(depth), 0, 1))
        return np.asarray(_WALL * light[..., None], np.float32)

    def project(self, position: tuple[float, float, float]) -> tuple[float, float]:
        """Column and row, in pixels of the finer picture, of a place in the map frame."""
        away = np.array(position[:2]) - self._centre
        u = (away @ self._right - self._left) / self._pixel
        level = away @ self._ahead * self._sin + position[2] * self._cos
        return float(u), float((self._top - level) / self._pixel)


def _pinned(picture: RgbImage, block: _Block, pins: Sequence[Pin]) -> RgbImage:
    size = max(13, round(picture.shape[1] / 60))
    texts: list[tuple[str, float, float, Anchor]] = []
    for pin in pins:
        u, v = (value / _FINER for value in block.project(pin.position))
        head = (round(u), round(v - 2.2 * size))
        cv2.line(picture, (round(u), round(v)), head, INK, max(1, size // 8), cv2.LINE_AA)
        cv2.circle(picture, head, size // 3, (200, 50, 30), -1, cv2.LINE_AA)
        cv2.circle(picture, head, size // 3, INK, 1, cv2.LINE_AA)
        texts.append((pin.name, u + size * 0.6, head[1], "lm"))
    return draw_texts(picture, texts, size, INK, halo=PAPER)
