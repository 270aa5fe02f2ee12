"""The picture of what the terrain has changed."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from ltm_ros.viewer.fuel_maps import ChangePicture


def test_changes_lie_in_the_map_and_stay_there_as_their_window_grows() -> None:
    under = GridGeometry(-100.0, 500.0, 20.0, 90, 70)
    kinds = np.full((30, 45), 255, np.uint8)
    kinds[8, 10] = 2
    for rows, cols in ((0, 0), (13, 7)):  # further cells to the north and west
        grown = np.pad(kinds, ((rows, 0), (cols, 0)), constant_values=255)
        window = GridGeometry(60.0 - 2.0 * cols, 300.0 + 2.0 * rows, 2.0, 45 + cols, 30 + rows)
        picture = ChangePicture.over(grown, window, under)
        (row, col) = np.argwhere(picture.kinds == 2)[0]
        place = np.array(picture.corner) + picture.pixel * (np.array([col, row]) + 0.5)
        np.testing.assert_allclose(place, [(60 + 21 + 100) / 20, (500 - 300 + 17) / 20])
