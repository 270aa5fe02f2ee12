"""Maps of the fuel map's layers for the viewer: fuel models, uncertainty, changes, coverage by cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ltm_core.dem import Dem
from ltm_core.grid import GridGeometry
from ltm_core.pictures import to_jpeg
from ltm_core.pictures.class_palette import ClassPalette
from ltm_core.pictures.fuel_maps import CAMERAS, DOUBT, CameraMark, FuelCanvas
from ltm_core.pictures.legend import PAPER
from ltm_core.types import RgbImage

TITLES = {
    "life_form": "Life form; outlined: no longer the prior map's",
    "code": "Fuel model",
    "entropy": "Doubt: entropy",
    "seen_by": "Cameras that see a cell",
}
"""By the last part of the entity `fuel_layers/...`."""


class FuelMaps:
    """Over one fuel grid. The relief is made once, cameras are where they stood at first."""

    def __init__(self, geometry: GridGeometry, dem: Dem, palette: ClassPalette, places: Sequence[CameraMark]) -> None:
        self.geometry = geometry
        self._palette = palette
        self._canvas = FuelCanvas(geometry, dem, places)

    def draw(self, rasters: Mapping[str, NDArray[Any]]) -> dict[str, rr.EncodedImage]:
        """A picture by each name of TITLES. `rasters`: (H, W) `life_form` (255 where nothing is told of the cell),
        `code`, `entropy`, `changed` and `seen_by`.
        """
        canvas, told = self._canvas, rasters["life_form"] != 255
        pictures = {
            "life_form": canvas.classes(rasters["life_form"], self._palette, rasters["changed"] > 0),
            "code": canvas.codes(rasters["code"]),
            "entropy": canvas.scaled(rasters["entropy"], told, DOUBT),
            "seen_by": canvas.scaled(rasters["seen_by"], rasters["seen_by"] > 0, CAMERAS),
        }
        return {
            name: rr.EncodedImage(contents=to_jpeg(_framed(picture, canvas.tallest), 88), media_type="image/jpeg")
            for name, picture in pictures.items()
        }


def _framed(picture: RgbImage, height: int) -> RgbImage:
    """Paper below, up to `height`: the viewer takes a row of JPEGs for a video, which may not change its size."""
    below = np.full((max(height - len(picture), 0), picture.shape[1], 3), PAPER, np.uint8)
    return np.concatenate([picture, below])
