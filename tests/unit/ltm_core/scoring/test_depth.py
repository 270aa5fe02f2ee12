"""Depth scores by range bin."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes.depth_score import score_depth

from ltm_core.base.errors import ImageError

TRUTH = np.array([[10, 99, 100, 299], [500, 5000, np.inf, np.nan], [200, 50, 999, 1000]], np.float32)
ERROR = np.array([[1, -3, 2, 4], [-10, 20, 0, 0], [np.nan, np.inf, 0, -40]], np.float32)


def test_bins_by_true_range() -> None:
    scores = score_depth([TRUTH + ERROR], [TRUTH])
    assert [(s.near, s.far) for s in scores[:-1]] == [(0, 100), (100, 300), (300, 1000), (1000, np.inf)]
    assert [s.pixels for s in scores] == [2, 2, 2, 2, 8]
    near = scores[0]
    assert (near.rmse, near.mae, near.median, near.bias) == (pytest.approx(math.sqrt(5)), 2.0, 2.0, -1.0)
    assert (scores[1].bias, scores[2].bias, scores[3].bias) == (3.0, -5.0, -10.0)


def test_over_all() -> None:
    total = score_depth([TRUTH + ERROR], [TRUTH])[-1]
    errors = np.array([1, -3, 2, 4, -10, 20, 0, -40])
    assert (total.near, total.far) == (0.0, np.inf)
    assert total.rmse == pytest.approx(math.sqrt((errors**2).mean()))
    assert total.mae == pytest.approx(10.0)
    assert total.median == pytest.approx(3.5)
    assert total.bias == pytest.approx(-26 / 8)


def test_images_of_several_shapes() -> None:
    scores = score_depth([TRUTH + 1, TRUTH[:2].T + 3], [TRUTH, TRUTH[:2].T])
    assert scores[0].pixels == 5
    assert scores[0].bias == pytest.approx((3 * 1 + 2 * 3) / 5)


def test_nothing_to_score() -> None:
    for scores in (score_depth([], []), score_depth([TRUTH * np.nan], [TRUTH])):
        assert [s.pixels for s in scores] == [0] * 5
        assert all(math.isnan(v) for s in scores for v in (s.rmse, s.mae, s.median, s.bias))


def test_pairs_must_fit() -> None:
    with pytest.raises(ImageError, match=r"\(4, 3\) cannot be scored against truth of \(3, 4\)"):
        score_depth([TRUTH.T], [TRUTH])
    with pytest.raises(ValueError, match="zip"):
        score_depth([TRUTH, TRUTH], [TRUTH])
