import numpy as np
import pytest

from ltm_core.base.errors import ImageError
from ltm_core.fuel.class_map import UNSEEN, MajorityFuelMap
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry

pytestmark = pytest.mark.kernel

GRID = GridGeometry(15.0, 105.0, 30.0, 4, 3)


def votes(cells: dict[tuple[int, int], list[int]], geometry: GridGeometry = GRID, classes: int = 3) -> CellVotes:
    rows, cols = np.array(list(cells), np.int32).reshape(-1, 2).T
    counts = np.array(list(cells.values()), np.uint32).reshape(-1, classes)
    return CellVotes(geometry, rows, cols, counts, np.zeros(len(rows), np.float32), 0, "north")


FRAMES = [
    votes({(0, 1): [5, 4, 0], (2, 3): [0, 0, 1]}),
    votes({(0, 1): [0, 2, 3], (1, 0): [0, 2, 2]}),
    votes({(2, 3): [1, 0, 0], (1, 2): [0, 0, 9]}),
]


def test_totals_win_not_frames() -> None:
    fuel = MajorityFuelMap(GRID, 3)
    for frame in FRAMES:
        fuel.add(frame)
    expected = np.full((3, 4), UNSEEN)
    expected[0, 1] = 1  # 5, 6, 3
    expected[1, 0] = 1  # 0, 2, 2: of equals, the first class
    expected[2, 3] = 0  # 1, 0, 1
    expected[1, 2] = 2
    np.testing.assert_array_equal(fuel.classes(), expected)
    assert fuel.classes().dtype == np.uint8


def test_counts_beyond_32_bits() -> None:
    fuel = MajorityFuelMap(GRID, 3)
    for _ in range(2):
        fuel.add(votes({(0, 0): [2**32 - 1, 2**32 - 2, 0]}))
    assert fuel.totals[0, 0].tolist() == [2**33 - 2, 2**33 - 4, 0]


def test_foreign_votes_are_refused() -> None:
    fuel = MajorityFuelMap(GRID, 3)
    with pytest.raises(ImageError, match=r"votes of north have grid and classes \(GridGeometry\(x_min=45.0"):
        fuel.add(votes({(0, 0): [1, 0, 0]}, GRID.translated(30.0, 0.0)))
    with pytest.raises(ImageError, match="votes of north"):
        fuel.add(votes({(0, 0): [1, 0]}, classes=2))
    assert not fuel.totals.any()
