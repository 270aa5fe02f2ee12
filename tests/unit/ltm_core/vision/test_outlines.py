import cv2
import numpy as np
import pytest

from ltm_core.base.types import BoolArray
from ltm_core.vision.areas import polygons_of
from ltm_core.vision.mask_config import MOST_POINTS
from ltm_core.vision.masks import fill


def enclosed(region: BoolArray, tolerance: float, filled: bool = False) -> BoolArray:
    drawn = np.zeros(region.shape, np.uint8)
    for outline in polygons_of(region, tolerance, filled):
        assert 3 <= len(outline) <= MOST_POINTS
        fill(drawn, outline)
    return drawn > 0


def test_a_ring_stays_a_ring_with_what_lies_in_it() -> None:
    region = np.zeros((50, 80), np.bool_)
    region[5:45, 10:70] = True
    region[10:40, 20:40] = False
    region[20:30, 25:35] = True
    region[10:40, 50:60] = False
    np.testing.assert_array_equal(enclosed(region, 0.5), region)
    full = np.zeros((50, 80), np.bool_)
    full[5:45, 10:70] = True
    np.testing.assert_array_equal(enclosed(region, 1.0, filled=True), full)


@pytest.mark.parametrize("seed", range(4))
def test_outlines_give_back_regions_with_many_holes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    height, width = (int(n) for n in rng.integers(20, 90, 2))
    smooth = cv2.GaussianBlur(rng.standard_normal((height, width)).astype(np.float32), (0, 0), 1.0 + seed / 6)
    region = np.asarray(smooth > rng.uniform(-0.8, 0.3) * smooth.std())
    np.testing.assert_array_equal(enclosed(region, 0.01), region)
    assert (enclosed(region, 0.5) != region).mean() < 0.02
