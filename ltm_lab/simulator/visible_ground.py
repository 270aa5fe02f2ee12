"""Finds the ground that is visible from an eye point, so that plants behind ridges are left out of its scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float64Array
from ltm_lab.simulator.terrain_synthesis import HeightField

_AZIMUTHS = 2048
_NEAR = 400.0  # m within which nothing counts as hidden
_LEDGE = 5.0  # m by which ground may be lower than the wide raster says
_STANDING = 24.0  # m, the tallest that stands on the ground
_SLACK = 36.0  # m: what lies so close behind a crest may still show, and throw shadows over it
_FAR = 1200.0  # m, where a cell begins to look narrow


@dataclass(frozen=True)
class VisibleGround:
    """Square cells of `side` metres, centred at (x0 + col side, y0 + row side): `seen` (rows, cols) says which may
    show."""

    seen: BoolArray
    x0: float
    y0: float
    side: float

    def at(self, x: ArrayLike, y: ArrayLike) -> BoolArray:
        """Whether the cells of map points may show; outside them: no."""
        col = np.rint((np.asarray(x) - self.x0) / self.side).astype(np.int64)
        row = np.rint((np.asarray(y) - self.y0) / self.side).astype(np.int64)
        rows, cols = self.seen.shape
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        return np.asarray(inside & self.seen[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)], np.bool_)


def line_of_sight(ground: HeightField, eye: Float64Array, side: float, bend: float) -> VisibleGround:
    """Which cells of `side` metres over `ground` hold something that may show from map point `eye` (3,).

    Errs on the side of showing: the ground that hides counts as lower and nearer than it is, what it hides as taller
    and wider. `bend`: metres that the earth sinks a square metre of distance.
    """
    g = ground.geometry
    step = g.resolution
    corners = np.hypot(np.array([g.x_min, g.x_max]) - eye[0], np.array([[g.y_min], [g.y_max]]) - eye[1])
    reach = np.arange(1, int(corners.max() / step) + 2) * step
    azimuth = np.arange(_AZIMUTHS) * (2 * np.pi / _AZIMUTHS)
    z = ground.at(eye[0] + np.sin(azimuth)[:, None] * reach, eye[1] + np.cos(azimuth)[:, None] * reach)
    slope = (z - _LEDGE - bend * reach**2 - eye[2]) / reach
    horizon = np.maximum.accumulate(slope, axis=1)
    narrow, wide = (
        ndimage.minimum_filter1d(
            horizon, 2 * int(np.ceil(0.75 * side / r / (2 * np.pi) * _AZIMUTHS)) + 1, 0, mode="wrap"
        )
        for r in (_FAR, _NEAR)
    )
    xs = np.arange(g.x_min, g.x_max + side, side)
    ys = np.arange(g.y_min, g.y_max + side, side)
    x, y = np.meshgrid(xs, ys)
    away = np.hypot(x - eye[0], y - eye[1])
    turn = np.rint(np.arctan2(x - eye[0], y - eye[1]) / (2 * np.pi) * _AZIMUTHS).astype(np.int64) % _AZIMUTHS
    before = np.clip(((away - _SLACK) / step).astype(np.int64) - 1, 0, len(reach) - 1)
    over = np.where(away > _FAR, narrow[turn, before], wide[turn, before])
    top = ndimage.maximum_filter(ground.at(x, y), 3) + _STANDING - bend * away**2
    seen = (away < _NEAR) | ((top - eye[2]) / np.maximum(away, 1.0) >= over)
    return VisibleGround(ndimage.binary_dilation(seen, np.ones((3, 3), bool)), float(xs[0]), float(ys[0]), side)
