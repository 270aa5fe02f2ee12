import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import DemStack
from ltm_core.surface.confirmed_surface import ConfirmedSurface

GRID = GridGeometry(100.0, 460.0, 2.0, 50, 30)


def confirmed(
    cells: list[tuple[int, int]], surface: list[float], ground: list[float] | None = None
) -> ConfirmedSurface:
    rows, cols = (np.array(part, np.int32) for part in zip(*cells, strict=True))
    below = np.full(len(cells), np.nan) if ground is None else np.array(ground)
    return ConfirmedSurface(GRID, rows, cols, np.array(surface, np.float32), below.astype(np.float32))


def sloping(geometry: GridGeometry) -> Dem:
    rows, cols = np.indices(geometry.shape)
    x, y = geometry.to_map(rows, cols)
    return Dem((300 + 0.3 * x - 0.1 * y).astype(np.float32), geometry)


def test_cells_of_the_same_grid_take_their_heights_and_no_other_moves() -> None:
    dem = sloping(GRID)
    found = confirmed([(3, 7), (3, 8), (20, 41)], [311.0, 312.0, 290.5]).surface_over(dem)
    moved = np.argwhere(found.elevation != dem.elevation)
    assert moved.tolist() == [[3, 7], [3, 8], [20, 41]]
    assert found.elevation[20, 41] == np.float32(290.5)
    assert dem.elevation[3, 7] != np.float32(311.0), "the terrain that was given is not written to"


@pytest.mark.parametrize("resolution", [1.0, 5.0])
def test_a_raster_of_other_cells_takes_them_at_its_nodes(resolution: float) -> None:
    other = GridGeometry(90.0, 470.0, resolution, round(140 / resolution), round(90 / resolution))
    dem = sloping(other)
    block = [(row, col) for row in range(8, 14) for col in range(10, 22)]
    found = confirmed(block, [350.0] * len(block)).surface_over(dem)
    rows, cols = np.nonzero(found.elevation != dem.elevation)
    x, y = other.to_map(rows, cols)
    inside = set(block)
    assert {(int(r), int(c)) for r, c in zip(*GRID.cell_of(x, y), strict=True)} <= inside
    assert len(rows) == pytest.approx(len(block) * (GRID.resolution / resolution) ** 2, rel=0.35)
    assert (found.elevation[rows, cols] == 350.0).all()


def test_bare_earth_follows_only_where_it_has_changed() -> None:
    dem = sloping(GRID)
    felled = confirmed([(3, 7)], [311.0])
    assert felled.ground_over(dem) is dem
    slid = confirmed([(3, 7), (4, 7)], [311.0, 309.0], [np.nan, 309.0])
    assert np.argwhere(slid.ground_over(dem).elevation != dem.elevation).tolist() == [[4, 7]]
    assert (felled.lowered, slid.lowered) == (0, 1)


def test_all_levels_of_a_stack_follow_but_not_at_their_seam() -> None:
    coarse = sloping(GridGeometry(0.0, 600.0, 4.0, 100, 85))
    stack = DemStack([sloping(GRID), coarse])
    middle, border = (14, 25), (14, 1)
    found = confirmed([border, middle], [900.0, 800.0]).surface_over(stack)
    assert found.elevation[middle] == 800.0
    assert found.elevation[border] == stack.elevation[border]
    x, y = GRID.to_map(*middle)
    fine = np.argwhere(found.levels[0].elevation != stack.levels[0].elevation)
    assert fine.tolist() == [list(middle)]
    assert float(found.elevation_at(x, y)) == pytest.approx(800.0)


def test_small_moves_are_no_difference() -> None:
    one = confirmed([(3, 7), (3, 8)], [311.0, 312.0])
    assert not one.differs_from(confirmed([(3, 7), (3, 8)], [311.5, 312.0]), 0.75)
    assert one.differs_from(confirmed([(3, 7), (3, 8)], [311.8, 312.0]), 0.75)
    assert one.differs_from(confirmed([(3, 7), (3, 9)], [311.0, 312.0]), 0.75)
    assert one.differs_from(confirmed([(3, 7), (3, 8)], [311.0, 312.0], [np.nan, 312.0]), 0.75)
