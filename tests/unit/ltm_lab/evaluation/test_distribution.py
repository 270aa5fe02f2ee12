import numpy as np
import pytest

from ltm_lab.evaluation.sim2real.distribution import (
    frechet_distance,
    kernel_distance,
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
