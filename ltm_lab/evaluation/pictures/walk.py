"""Map of a walk: where photos were taken and which way they look, by poses of several kinds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.types import Float64Array, RgbImage
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import label_legend, with_legend
from ltm_core.pictures.maps import furnished, relief, scale_bar, view_of
from ltm_core.raster.dem import Dem

_WIDTH = 1000
_COLORS = ((205, 40, 40), (0, 130, 220), (25, 25, 25), (240, 150, 0))
_SHARE = 0.11
"""Of the map's width: how long an arrow is."""
_SHIFT = 4  # OpenCV draws at 1/16 pixel


@dataclass(frozen=True)
class _Kinds:
    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]


def walk_map(dem: Dem, directions: Mapping[str, Float64Array]) -> RgbImage:
    """Arrows over relief, (H, W, 3).

    `directions`: by the name of their kind, (N, 3): x, y in the map frame (m) and azimuth (degrees), at most four
    kinds; later ones are drawn over earlier ones.
    """
    view = _view(np.concatenate(list(directions.values())))
    picture = relief(dem, view)
    reach = _SHARE * view.width * view.resolution
    for (_, poses), color in zip(directions.items(), _COLORS, strict=False):
        azimuth = np.radians(poses[:, 2])
        tips = poses[:, :2] + reach * np.column_stack([np.sin(azimuth), np.cos(azimuth)])
        for begin, end in zip(_pixels(view, poses[:, :2]), _pixels(view, tips), strict=True):
            cv2.arrowedLine(picture, begin, end, color, 2, cv2.LINE_AA, _SHIFT, 0.12)
    kinds = _Kinds(tuple(directions), _COLORS[: len(directions)])
    furniture = furnished(picture, view, [], None)
    return with_legend(furniture, scale_bar(view), label_legend(_WIDTH, kinds, range(len(kinds.names))))


def _view(poses: Float64Array) -> GridGeometry:
    low, high = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
    span = float((high - low).max())
    margin = max(30.0, 0.25 * span)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 0.3 * span) + margin
    return view_of((*(middle - half), *(middle + half)), _WIDTH)


def _pixels(view: GridGeometry, points: Float64Array) -> list[tuple[int, int]]:
    row, col = view.to_grid(points[:, 0], points[:, 1])
    return [(round(c * 2**_SHIFT), round(r * 2**_SHIFT)) for c, r in zip(col.tolist(), row.tolist(), strict=True)]
