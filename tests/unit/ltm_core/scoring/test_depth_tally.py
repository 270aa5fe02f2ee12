from __future__ import annotations

import numpy as np
import pytest
from scenes.depth_score import score_depth

from ltm_core.scoring.depth import DepthTally

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


def test_frame_by_frame_is_all_at_once() -> None:
    random = np.random.default_rng(3)
    truths = [random.uniform(5, 4000, (7, 13)).astype(np.float32) for _ in range(5)]
    estimates = [t + random.normal(0.4, 9, t.shape).astype(np.float32) for t in truths]
    for truth, estimate in zip(truths, estimates, strict=True):
        truth[random.random(truth.shape) < 0.1] = INF
        estimate[random.random(truth.shape) < 0.1] = np.nan
    tally = DepthTally()
    for truth, estimate in zip(truths, estimates, strict=True):
        tally.add(estimate, truth)
    for found, expected in zip(tally.scores(), score_depth(estimates, truths), strict=True):
        assert (found.near, found.far, found.pixels) == (expected.near, expected.far, expected.pixels)
        for name in ("rmse", "mae", "bias"):
            assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-5, nan_ok=True)
        # Between the two middle errors of an even number any value is a median: allow their distance.
        assert found.median == pytest.approx(expected.median, rel=0.05, nan_ok=True)
    assert 0.85 < tally.coverage < 0.95
