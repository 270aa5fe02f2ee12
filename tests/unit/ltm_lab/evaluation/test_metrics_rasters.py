from __future__ import annotations

import numpy as np
import pytest

from ltm_core.base.errors import ImageError, RasterError
from ltm_lab.evaluation.metrics.change import score_change
from ltm_lab.evaluation.metrics.skyline import SkylineTally, depth_skyline, skyline


def test_change() -> None:
    truth = np.array([[1, 1, 1, 0], [0, 0, 0, 0], [1, 0, 0, 0]], bool)
    found = np.array([[1, 1, 0, 1], [0, 0, 0, 0], [1, 0, 0, 1]], bool)
    observed = np.ones((3, 4), bool)
    observed[2] = False
    score = score_change(found, truth, observed)
    assert (score.hits, score.false_alarms, score.misses, score.quiet, score.cells) == (2, 1, 1, 4, 8)
    assert (score.precision, score.recall, score.f1, score.iou) == pytest.approx((2 / 3, 2 / 3, 2 / 3, 0.5))
    assert score_change(found, truth).hits == 3
    nothing = score_change(np.zeros((1, 2), bool), np.zeros((1, 2), bool))
    assert np.isnan([nothing.precision, nothing.recall, nothing.f1]).all()
    with pytest.raises(RasterError, match="change of"):
        score_change(found, truth.T)


def test_skyline_of_a_mask() -> None:
    #                begins at 1, 2; no sky on top; sky throughout; a hole of sky below the line does not count
    sky = np.array([[1, 1, 0, 1, 1], [0, 1, 1, 1, 1], [0, 0, 0, 1, 0], [0, 0, 0, 1, 1]], bool)
    np.testing.assert_array_equal(skyline(sky), [1, 2, np.nan, np.nan, 2])
    unknown = np.zeros_like(sky)
    unknown[2, 1] = True
    np.testing.assert_array_equal(skyline(sky, unknown), [1, np.nan, np.nan, np.nan, 2])
    depth = np.array([[np.inf, np.inf], [30, np.nan], [9, 9]], np.float32)
    np.testing.assert_array_equal(depth_skyline(depth), [1, np.nan])


def test_skyline_of_a_sampled_truth_is_not_biased() -> None:
    rows = np.arange(40, 80, dtype=np.float32)  # the true first row below the sky, in each of 40 columns
    step = 4
    first_sample = np.ceil(rows[::step] / step)  # first sampled row at or below it
    tally = SkylineTally()
    for shift in range(step):  # all phases of the line within a step
        tally.add(rows + shift, np.ceil((rows + shift)[::step] / step).astype(np.float32), step)
    assert (first_sample * step >= rows[::step]).all()
    score = tally.score()
    assert (score.columns, score.resolution) == (40, 4)
    assert score.bias == pytest.approx(0)
    assert score.mean <= (step - 1) / 2
    with pytest.raises(ImageError, match="columns"):
        tally.add(rows, rows, step)
