import numpy as np
import pytest

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.scoring.fuel import score_fuel

GRID = GridGeometry(15.0, 105.0, 30.0, 3, 2, "EPSG:32611")
MAPPED = np.array([[1, 2, 255], [2, 0, 1]], np.uint8)
TRUTH = np.array([[1, 1, 1], [2, 255, 2]], np.uint8)


def test_same_grid() -> None:
    score = score_fuel(MAPPED, GRID, TRUTH, GRID, 3)
    assert (score.cells, score.seen, score.right) == (6, 4, 2)
    # [true, mapped]: right are 1 as 1 and 2 as 2; a true 1 was mapped as 2 and a true 2 as 1.
    assert score.confusion.tolist() == [[0, 0, 0], [0, 1, 1], [0, 1, 1]]


def test_offset_grids() -> None:
    wide = np.full((5, 7), 255, np.uint8)
    wide[2:4, 1:4] = TRUTH
    around = GridGeometry(15.0 - 30, 105.0 + 60, 30.0, 7, 5, "EPSG:32611")
    assert score_fuel(MAPPED, GRID, wide, around, 3).confusion.tolist() == [[0, 0, 0], [0, 1, 1], [0, 1, 1]]
    # Truth over the eastern two columns alone.
    part = score_fuel(MAPPED, GRID, TRUTH[:, 1:], GRID.window(0, 1, 2, 2), 3)
    assert (part.cells, part.seen, part.right) == (6, 2, 0)
    apart = score_fuel(MAPPED, GRID, TRUTH, GRID.translated(900.0, 0.0, "EPSG:32611"), 3)
    assert (apart.cells, apart.seen, apart.right) == (6, 0, 0)


@pytest.mark.parametrize(
    "other",
    [
        GRID.translated(15.0, 0.0, "EPSG:32611"),
        GRID.translated(0.0, 1.0, "EPSG:32611"),
        GridGeometry(15.0, 105.0, 10.0, 3, 2, "EPSG:32611"),
    ],
)
def test_cells_must_coincide(other: GridGeometry) -> None:
    with pytest.raises(RasterError, match="cells differ"):
        score_fuel(MAPPED, GRID, TRUTH, other, 3)
