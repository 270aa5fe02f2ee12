"""Maps of the fuel map's layers for the viewer: fuel models, uncertainty, changes, coverage by cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, RgbImage
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures import to_jpeg
from ltm_core.pictures.drawing import ClassPalette
from ltm_core.pictures.fuel_maps import CAMERAS, DOUBT, CameraMark, FuelCanvas
from ltm_core.pictures.legend import PAPER
from ltm_core.raster.dem import Dem
from ltm_ros.fuel_map.pictures import seen_window

TITLES = {
    "life_form": "Life form; outlined: no longer the prior map's",
    "code": "Fuel model",
    "entropy": "Doubt: entropy",
    "seen_by": "Cameras that see a cell",
}
"""By the last part of the entity `fuel_layers/...`."""


_ROOM = 0.1
"""Share of its size by which a window is larger than what is seen, so that it is not drawn anew for every cell."""
_SLACK = 60
"""Pixels by which the axes and legends of two windows may differ."""

Bounds = tuple[float, float, float, float]


class FuelMaps:
    """Over one fuel grid, of the part around what cameras have touched, and of all of it before they have touched any.
    The relief is made once a window, cameras are where they stood at first.
    """

    def __init__(self, geometry: GridGeometry, dem: Dem, palette: ClassPalette, places: Sequence[CameraMark]) -> None:
        self.geometry = geometry
        self._dem, self._palette, self._places = dem, palette, places
        self._canvas = FuelCanvas(geometry, dem, places)
        self._whole = self._canvas.view
        self.window: Bounds | None = None
        """West, south, east and north of what is drawn; None: everything."""
        self._size: tuple[int, int] | None = None

    def draw(self, rasters: Mapping[str, NDArray[Any]]) -> dict[str, rr.EncodedImage]:
        """A picture by each name of TITLES. `rasters`: (H, W) `life_form` (255 where nothing is told of the cell),
        `code`, `entropy`, `changed` and `seen_by`.
        """
        self._follow((rasters["seen_by"] > 0) | (rasters["changed"] > 0))
        canvas, told = self._canvas, rasters["life_form"] != 255
        pictures = {
            "life_form": canvas.classes(rasters["life_form"], self._palette, rasters["changed"] > 0),
            "code": canvas.codes(rasters["code"]),
            "entropy": canvas.scaled(rasters["entropy"], told, DOUBT),
            "seen_by": canvas.scaled(rasters["seen_by"], rasters["seen_by"] > 0, CAMERAS),
        }
        if self._size is None:
            self._size = canvas.tallest + _SLACK, pictures["code"].shape[1] + _SLACK
        size = self._size
        return {
            name: rr.EncodedImage(contents=to_jpeg(_framed(picture, size), 88), media_type="image/jpeg")
            for name, picture in pictures.items()
        }

    def _follow(self, touched: BoolArray) -> None:
        """Draw the part around the touched cells (H, W); another one only when they have grown out of the present."""
        if not touched.any():
            return
        needed = seen_window(self.geometry, touched, self._places)
        if self.window is None or not _within(needed, self.window):
            self.window = _shaped(needed, self._whole)
            self._canvas = FuelCanvas(self.geometry, self._dem, self._places, self.window)


def _within(inner: Bounds, outer: Bounds) -> bool:
    return inner[0] >= outer[0] and inner[1] >= outer[1] and inner[2] <= outer[2] and inner[3] <= outer[3]


def _shaped(bounds: Bounds, view: GridGeometry) -> Bounds:
    """Bounds with room around, inside `view` and as high for their width, so that all pictures have one size."""
    west, south, east, north = bounds
    x_min, y_min, x_max, y_max = view.bounds
    share = min(max((east - west) / (x_max - x_min), (north - south) / (y_max - y_min)) * (1 + _ROOM), 1.0)
    half_x, half_y = share * (x_max - x_min) / 2, share * (y_max - y_min) / 2
    x = min(max((west + east) / 2, x_min + half_x), x_max - half_x)
    y = min(max((south + north) / 2, y_min + half_y), y_max - half_y)
    return x - half_x, y - half_y, x + half_x, y + half_y


def _framed(picture: RgbImage, size: tuple[int, int]) -> RgbImage:
    """On paper of one size: the viewer takes a row of JPEGs for a video, which may not change its size."""
    height, width = size
    paper = np.full((height, width, 3), PAPER, np.uint8)
    paper[: len(picture), : picture.shape[1]] = picture[:height, :width]
    return paper
