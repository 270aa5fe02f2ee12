import numpy as np
import pytest

from ltm_core.base.types import BoolArray
from ltm_core.surface.change import WIDE, regions, stand_rise

pytestmark = pytest.mark.kernel

SHAPE = (50, 70)


@pytest.fixture
def stand() -> BoolArray:
    inside = np.zeros(SHAPE, np.bool_)
    inside[8:40, 20:61] = True
    return inside


def test_a_region_goes_on_through_what_nobody_sees_of_a_stand_and_not_over_what_is_as_it_was() -> None:
    weak = np.zeros(SHAPE, np.bool_)
    weak[10:14, 5:12] = weak[10:14, 22:30] = weak[30:34, 5:12] = weak[30:34, 22:30] = True
    strong = np.zeros(SHAPE, np.bool_)
    strong[11, 6] = strong[31, 6] = True
    unseen = np.zeros(SHAPE, np.bool_)
    unseen[10:14, 12:22] = True
    kept = regions(strong, weak, unseen, 25.0)
    assert kept[10:14, 5:12].all()
    assert kept[10:14, 22:30].all()
    assert kept[30:34, 5:12].all()
    assert not kept[30:34, 22:30].any()
    assert not kept[~weak].any()


def test_a_region_without_a_sure_cell_or_too_small_is_left_out() -> None:
    weak = np.zeros(SHAPE, np.bool_)
    weak[5:15, 5:15] = weak[30:33, 50:54] = True
    strong = np.zeros(SHAPE, np.bool_)
    strong[31, 51] = True
    assert not regions(strong, weak, np.zeros(SHAPE, np.bool_), 25.0).any()
    assert regions(strong, weak, np.zeros(SHAPE, np.bool_), 12.0).sum() == 12


def test_a_stand_has_grown_by_what_its_level_cells_show(stand: BoolArray) -> None:
    """Faces, a slope four times the block's, show a quarter of it; what is not grown takes no part."""
    top = stand & (np.add.outer(np.arange(SHAPE[0]), 2 * np.arange(SHAPE[1])) % 3 == 0)
    off = np.where(top, 4.0, np.where(stand, 1.0, -9.0)).astype(np.float32)
    level = np.where(top, 1.0, 1 / 16).astype(np.float32)
    before = np.full(SHAPE, 2.0, np.float32)
    rise = stand_rise(off, level, stand, before, 1.0)
    inner = np.zeros(SHAPE, np.bool_)
    inner[18:30, 32:50] = True
    # Two faces to a top, each with a weight of 1 / 256.
    np.testing.assert_allclose(rise[inner], (4.0 + 2 / 256) / (1 + 2 / 256), atol=1e-2)
    alone = np.zeros(SHAPE, np.bool_)
    alone[4, 60] = True
    far = np.hypot(*(np.indices(SHAPE) - np.array([4, 60])[:, None, None])) > 6 * WIDE
    np.testing.assert_array_equal(stand_rise(off, level, alone, before, 1.0)[far], 2.0)
