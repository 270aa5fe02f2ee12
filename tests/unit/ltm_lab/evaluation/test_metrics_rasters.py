from __future__ import annotations

import numpy as np
import pytest

from ltm_core.base.errors import RasterError
from ltm_lab.evaluation.metrics.change import score_change


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
