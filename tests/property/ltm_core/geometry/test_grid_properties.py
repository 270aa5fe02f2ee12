"""What must hold on any grid."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ltm_core.geometry.grid import GridGeometry

# Eighths of a metre are exact in float64, so that edges are hit and not only approached.
metres = st.integers(-80_000, 80_000).map(lambda n: n / 8)
resolutions = st.sampled_from([0.5, 1.0, 2.0, 7.0, 30.0, 33.0])
grids = st.builds(GridGeometry, metres, metres, resolutions, st.integers(1, 50), st.integers(1, 40))


@given(grids, metres, metres)
def test_a_point_lies_in_its_cell_and_in_no_other(grid: GridGeometry, x: float, y: float) -> None:
    row, col = (int(v) for v in grid.cell_of(x, y))
    west, north = grid.x_min + col * grid.resolution, grid.y_max - row * grid.resolution
    assert west <= x < west + grid.resolution
    assert north - grid.resolution < y <= north
    assert bool(grid.contains(row, col)) == (grid.x_min <= x < grid.x_max and grid.y_min < y <= grid.y_max)


@given(grids, metres, metres)
def test_to_grid_and_back(grid: GridGeometry, x: float, y: float) -> None:
    np.testing.assert_allclose(grid.to_map(*grid.to_grid(x, y)), (x, y), atol=1e-8)


@given(grids, st.integers(-9, 60), st.integers(-9, 60))
def test_the_centre_of_a_cell_is_in_it(grid: GridGeometry, row: int, col: int) -> None:
    assert [int(v) for v in grid.cell_of(*grid.to_map(row, col))] == [row, col]
    window = grid.window(row, col, 3, 2)
    np.testing.assert_array_equal(window.to_map(0, 0), grid.to_map(row, col))


@given(metres, metres, st.floats(0, 500), st.floats(0, 500), resolutions, st.sampled_from([0.0, 15.0, -4.5]))
def test_snapped_is_the_smallest_cover(
    x: float, y: float, width: float, height: float, resolution: float, phase: float
) -> None:
    grid = GridGeometry.snapped((x, y, x + width, y + height), resolution, phase)
    x_min, y_min, x_max, y_max = grid.bounds
    assert x_min <= x
    assert y_min <= y
    assert x_max >= x + width
    assert y_max >= y + height
    assert x - x_min < resolution
    assert y - y_min < resolution or grid.height == 1  # bounds of no height may lie on an edge
    assert x_max - (x + width) < resolution or grid.width == 1
    assert y_max - (y + height) < resolution or grid.height == 1
    for edge in grid.bounds:
        assert ((edge - phase) / resolution).is_integer()
