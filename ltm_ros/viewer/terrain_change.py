"""Draws the terrain node's changes: a picture of a window of the map, and the changed cells as points."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import rerun as rr

from ltm_core.base.types import Float32Array, Int32Array, UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.drawing import UNLABELLED
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.surface_io import CHANGE_COLORS

PICTURE_PIXELS = 1600
"""Longer side of the picture of changes."""
MAX_POINTS = 60_000
"""Changed cells in the 3D view."""
_COLORS = np.array([CHANGE_COLORS[kind] for kind in ChangeKind], np.uint8)


@dataclass(eq=False)
class ChangeLayer:
    """The changed cells so far; each update says which cells have another kind now."""

    _cells: dict[tuple[int, int], tuple[float, float, float, int]] = field(default_factory=dict)

    def update(self, cells: Int32Array, points: Float32Array, kinds: UInt8Array) -> rr.Points3D:
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
            colors=_COLORS[drawn[:, 3].astype(np.int64)],
            radii=rr.Radius.ui_points(2.5),
        )


@dataclass(frozen=True, eq=False)
class ChangePicture:
    """Kinds of change, thinned for the screen, and where they lie on the grid under them."""

    kinds: UInt8Array
    """(h, w) ChangeKind, 255 where independent views have not looked."""
    corner: tuple[float, float]
    """x, y of its north-west corner, in cells of the grid under it."""
    pixel: float
    """Side of a pixel in such cells."""

    @classmethod
    def over(cls, kinds: UInt8Array, geometry: GridGeometry, under: GridGeometry) -> ChangePicture:
        """`kinds` (H, W) of a window of the terrain's grid."""
        step = max(1, -(-max(geometry.shape) // PICTURE_PIXELS))
        corner = (geometry.x_min - under.x_min) / under.resolution, (under.y_max - geometry.y_max) / under.resolution
        return cls(_thinned(kinds, step), corner, geometry.resolution * step / under.resolution)

    def archetypes(self) -> tuple[rr.Transform3D, rr.SegmentationImage]:
        """Class ids, not a JPEG: the viewer takes a row of JPEGs for a video, and a video cannot grow."""
        place = rr.Transform3D(translation=(*self.corner, 0.0), scale=(self.pixel, self.pixel, 1.0))
        return place, rr.SegmentationImage(self.kinds, opacity=1.0, draw_order=1.0)


def change_classes() -> rr.AnnotationContext:
    """Colours of the kinds of change; ground that was looked at and has not changed is veiled."""
    classes = [(kind, kind.name.lower(), (*CHANGE_COLORS[kind], 230)) for kind in ChangeKind]
    classes[ChangeKind.NONE] = (ChangeKind.NONE, "looked at", (255, 215, 100, 100))
    return rr.AnnotationContext([*classes, (UNLABELLED, "not looked at", (0, 0, 0, 0))])


def _thinned(kinds: UInt8Array, step: int) -> UInt8Array:
    """Every pixel a block of `step` x `step` cells; a change in any cell of a block stands for the block."""
    height, width = kinds.shape
    padded = np.full((-(-height // step) * step, -(-width // step) * step), UNLABELLED, np.uint8)
    padded[:height, :width] = kinds
    blocks = padded.reshape(padded.shape[0] // step, step, padded.shape[1] // step, step)
    changed = np.where(blocks == UNLABELLED, 0, blocks).max(axis=(1, 3))
    looked = (blocks != UNLABELLED).any(axis=(1, 3))
    return np.where(looked, changed, UNLABELLED).astype(np.uint8)
