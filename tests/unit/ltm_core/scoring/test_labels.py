"""Segmentation scores against counts made by hand."""

import numpy as np
import pytest

from ltm_core.base.errors import ImageError
from ltm_core.scoring.labels import SegmentationScore

TRUTH = np.array([[0, 0, 1, 1, 1], [2, 2, 2, 255, 255]], np.uint8)
FOUND = np.array([[0, 1, 1, 1, 255], [2, 2, 0, 0, 2]], np.uint8)


def test_scores_are_those_counted_by_hand() -> None:
    score = SegmentationScore.empty(4).plus(TRUTH, FOUND)
    expected = [[1, 1, 0, 0, 0], [0, 2, 0, 0, 1], [1, 0, 2, 0, 0], [0, 0, 0, 0, 0]]
    np.testing.assert_array_equal(score.confusion, expected)
    assert score.pixels == 8
    np.testing.assert_allclose(score.iou, [1 / 3, 2 / 4, 2 / 3, np.nan])
    np.testing.assert_allclose(score.f1, [2 / 4, 4 / 6, 4 / 5, np.nan])
    np.testing.assert_allclose(score.precision, [1 / 2, 2 / 3, 1, np.nan])
    np.testing.assert_allclose(score.recall, [1 / 2, 2 / 3, 2 / 3, np.nan])
    assert score.accuracy == pytest.approx(5 / 8)
    assert score.unlabelled == pytest.approx(1 / 8)
    assert score.mean_iou == pytest.approx((1 / 3 + 2 / 4 + 2 / 3) / 3)
    assert score.macro_f1() == pytest.approx((2 / 4 + 4 / 6 + 4 / 5) / 3), "a class without true pixels is left out"
    assert score.macro_f1([1, 2, 3]) == pytest.approx((4 / 6 + 4 / 5) / 2)


def test_frames_add_up() -> None:
    once = SegmentationScore.empty(3).plus(TRUTH, FOUND)
    twice = once.plus(TRUTH, FOUND)
    np.testing.assert_array_equal(twice.confusion, 2 * once.confusion)


def test_no_truth_gives_no_score() -> None:
    score = SegmentationScore.empty(3)
    assert np.isnan(score.mean_iou)
    assert np.isnan(score.accuracy)


def test_label_images_of_two_shapes_are_refused() -> None:
    with pytest.raises(ImageError, match=r"\(2, 4\).*\(2, 5\)"):
        SegmentationScore.empty(3).plus(TRUTH, FOUND[:, :4])
