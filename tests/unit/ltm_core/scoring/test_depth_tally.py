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
    assert (beyond.median, whole.median) == (100, 6.5)
    assert whole.bias == pytest.approx(23)
    assert tally.coverage == 1.0
