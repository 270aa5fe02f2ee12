"""What the terrain node found changed, drawn: the window over relief, and the changed cells as points."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ltm_core.dem import Dem
from ltm_core.grid import GridGeometry
from ltm_core.pictures import labelled_shade, to_jpeg
from ltm_core.pictures.types import UNLABELLED, Labels
from ltm_core.terrain.change import ChangeKind
from ltm_core.terrain.terrain_io import CHANGE_COLORS

PICTURE_PIXELS = 1600
"""Longer side of the picture of changes."""
MAX_POINTS = 60_000
"""Changed cells in the 3D view."""


@dataclass(frozen=True)
class ChangePalette:
    """The kinds of change as classes."""

    names: tuple[str, ...] = tuple(kind.name.lower() for kind in ChangeKind)
    colors: tuple[tuple[int, int, int], ...] = tuple(CHANGE_COLORS[kind] for kind in ChangeKind)


@dataclass(eq=False)
class ChangeLayer:
    """The changed cells so far; each update says which cells have another kind now."""

    _cells: dict[tuple[int, int], tuple[float, float, float, int]] = field(default_factory=dict)

    def update(self, cells: NDArray[np.int32], points: NDArray[np.float32], kinds: NDArray[np.uint8]) -> rr.Points3D:
        """Take cells (N, 2) row, col with their places (N, 3) and kinds (N,), and draw all that differ by now."""
        for (row, col), place, kind in zip(cells.tolist(), points.tolist(), kinds.tolist(), strict=True):
            if kind == ChangeKind.NONE:
                self._cells.pop((row, col), None)
            else:
                self._cells[row, col] = (*place, kind)
        drawn = np.array(list(self._cells.values()), np.float64).reshape(-1, 4)
        drawn = drawn[:: 1 + len(drawn) // MAX_POINTS]
        return rr.Points3D(
            drawn[:, :3].astype(np.float32),
            colors=np.array(ChangePalette().colors, np.uint8)[drawn[:, 3].astype(np.int64)],
            radii=rr.Radius.ui_points(2.5),
        )


def change_picture(kinds: Labels, geometry: GridGeometry, dem: Dem) -> rr.EncodedImage:
    """Kinds of change (H, W), 255 where independent views have not looked, over relief."""
    step = max(1, -(-max(geometry.shape) // PICTURE_PIXELS))
    view = GridGeometry(
        geometry.x_min,
        geometry.y_max,
        geometry.resolution * step,
        -(-geometry.width // step),
        -(-geometry.height // step),
        geometry.crs,
    )
    picture = labelled_shade(_thickened(kinds, step), geometry, ChangePalette(), dem, view, opacity=0.75)
    return rr.EncodedImage(contents=to_jpeg(picture, 88), media_type="image/jpeg")


def _thickened(kinds: Labels, step: int) -> Labels:
    """Where pixels skip cells, a change in any cell of a pixel's block stands for the block."""
    if step == 1:
        return kinds
    height, width = kinds.shape
    padded = np.full((-(-height // step) * step, -(-width // step) * step), UNLABELLED, np.uint8)
    padded[:height, :width] = kinds
    blocks = padded.reshape(padded.shape[0] // step, step, padded.shape[1] // step, step)
    changed = np.where(blocks == UNLABELLED, 0, blocks).max(axis=(1, 3), keepdims=True)
    return np.where(changed > 0, changed, blocks).reshape(padded.shape)[:height, :width].astype(np.uint8)
