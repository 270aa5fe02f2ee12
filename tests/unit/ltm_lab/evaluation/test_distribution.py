from __future__ import annotations

import numpy as np
import pytest

from ltm_lab.evaluation.sim2real.distribution import (
    frechet_distance,
    kernel_distance,
    mean_with_interval,
    with_interval,
)


def features(count: int, width: int, seed: int, shift: float = 0.0) -> np.ndarray:
    random = np.random.default_rng(seed)
    mixing = np.random.default_rng(99).normal(size=(width, width))
    return random.normal(size=(count, width)) @ mixing + shift


def test_distance_to_itself_is_none() -> None:
    for count in (9, 60):  # fewer images than features, and more
        same = features(count, 20, 1)
        scale = np.trace(np.cov(same.T))
        assert frechet_distance(same, same) == pytest.approx(0, abs=1e-9 * scale)


def test_kernel_distance_by_hand() -> None:
    a, b = np.array([[0.0, 0.0], [2.0, 0.0]]), np.array([[0.0, 2.0], [0.0, 4.0], [2.0, 2.0]])

    def k(x: np.ndarray, y: np.ndarray) -> float:
        return float((x @ y / 2 + 1) ** 3)

    within_a = k(a[0], a[1])
    within_b = (k(b[0], b[1]) + k(b[0], b[2]) + k(b[1], b[2])) / 3
    between = np.mean([k(x, y) for x in a for y in b])
    assert kernel_distance(a, b) == pytest.approx(within_a + within_b - 2 * between)


def test_intervals() -> None:
    values = np.random.default_rng(5).normal(3, 2, 400)
    mean = mean_with_interval(values, seed=1)
    assert mean.value == values.mean()
    assert mean.high - mean.low == pytest.approx(2 * 1.96 * 2 / np.sqrt(400), rel=0.15)
    assert mean_with_interval(values, seed=1) == mean
    # The spread of the halves is the spread of the whole: against fresh draws of the same size.
    drawn = [kernel_distance(features(40, 4, 1000 + 2 * s), features(40, 4, 1001 + 2 * s, 1.0)) for s in range(300)]
    found = [
        with_interval(kernel_distance, features(40, 4, 7 + s), features(40, 4, 500 + s, 1.0), seed=s) for s in range(12)
    ]
    width = np.mean([estimate.high - estimate.low for estimate in found])
    assert width == pytest.approx(2 * 1.96 * np.std(drawn), rel=0.35)
    few = with_interval(kernel_distance, features(3, 4, 1), features(9, 4, 2))
    assert np.isfinite(few.value)
    assert np.isnan(few.low)
