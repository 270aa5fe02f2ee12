"""Rows and columns against map coordinates."""

from __future__ import annotations

import pytest

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry

GRID = GridGeometry(100.0, 500.0, 10.0, 7, 4, "EPSG:32611")


def test_edges_and_shape() -> None:
    assert GRID.shape == (4, 7)
    assert GRID.bounds == (100.0, 460.0, 170.0, 500.0)


def test_translated() -> None:
    moved = GRID.translated(-100.0, 20.0)
    assert (moved.bounds, moved.crs) == ((0.0, 480.0, 70.0, 520.0), None)
    assert GRID.translated(0.0, 0.0, crs="EPSG:5070").crs == "EPSG:5070"


def test_window() -> None:
    window = GRID.window(1, 3, 2, 4)
    assert window == GridGeometry(130.0, 490.0, 10.0, 4, 2, "EPSG:32611")
    assert [float(v) for v in window.to_map(0, 0)] == [float(v) for v in GRID.to_map(1, 3)]


def test_snapped_to_another_phase() -> None:
    assert GridGeometry.snapped((1.0, 1.0, 9.0, 4.0), 5.0, phase=2.0).bounds == (-3.0, -3.0, 12.0, 7.0)


def test_transform_maps_the_pixel_corner() -> None:
    # x = a column + b row + c, y = d column + e row + f, columns and rows counted at pixel corners.
    assert tuple(GRID.transform())[:6] == (10.0, 0.0, 100.0, 0.0, -10.0, 500.0)


@pytest.mark.parametrize(
    "values",
    [
        (float("nan"), 0.0, 1.0, 2, 2),
        (0.0, float("inf"), 1.0, 2, 2),
        (0.0, 0.0, 0.0, 2, 2),
        (0.0, 0.0, -30.0, 2, 2),
        (0.0, 0.0, 1.0, 0, 2),
        (0.0, 0.0, 1.0, 2, -1),
    ],
)
def test_no_raster(values: tuple[float, float, float, int, int]) -> None:
    with pytest.raises(RasterError, match="raster"):
        GridGeometry(*values)
