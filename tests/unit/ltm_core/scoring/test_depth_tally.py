from __future__ import annotations

import numpy as np
import pytest

from ltm_core.scoring.labels import DepthTally

INF = np.float32(np.inf)


def test_known_errors_by_range() -> None:
    truth = np.array([[50.0, 60.0, 200.0], [1500.0, INF, np.nan]], np.float32)
    estimate = np.array([[53.0, 59.0, 190.0], [1600.0, 20.0, 30.0]], np.float32)
    tally = DepthTally()
    tally.add(estimate, truth)
    near, middle, far, beyond, whole = tally.scores()
    assert (near.pixels, middle.pixels, far.pixels, beyond.pixels, whole.pixels) == (2, 1, 0, 1, 4)
    assert (near.mae, near.bias) == (2.0, 1.0)
    assert near.rmse == pytest.approx(np.sqrt(5))
    assert (middle.bias, middle.rmse) == (-10.0, 10.0)
    assert np.isnan(far.median)
    assert beyond.median == pytest.approx(100, rel=0.004)
    assert whole.bias == pytest.approx(23)
    assert tally.coverage == 1.0


@pytest.mark.parametrize("size", [0.0, 5e-5, 0.03, 2.0, 4321.0])
def test_median_of_equal_errors(size: float) -> None:
    tally = DepthTally()
    tally.add(np.full((3, 5), 9000 + size, np.float64), np.full((3, 5), 9000.0))
    assert tally.scores()[-1].median == pytest.approx(size, rel=0.006, abs=1e-4)
