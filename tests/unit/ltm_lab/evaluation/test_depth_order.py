import numpy as np
import pytest
from scenes.depth_order import depth_order


def test_pairs_that_are_clearly_apart_are_counted() -> None:
    truth = [100.0, 105.0, 200.0, 400.0, np.nan]
    # 100-105 is no clear pair; of the five others 200-400 is turned round.
    order = depth_order([1.0, 2.0, 4.0, 3.0, 9.0], truth)
    assert (order.pairs, order.right) == (5, pytest.approx(0.8))


def test_ties_are_wrong_and_inverse_depth_is_given_negative() -> None:
    assert depth_order([2.0, 2.0], [10.0, 20.0]).right == 0.0
    assert depth_order(-np.array([0.5, 0.1]), [10.0, 20.0]).right == 1.0
    assert np.isnan(depth_order([1.0], [2.0]).right)
