"""The line that most points agree on."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.depth.scale_fit import robust_line, robust_offset

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize("seed", range(8))
def test_scale_and_shift_come_back_through_forty_percent_of_outliers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.1, 0.9, 3000)
    y = 0.02 * x - 0.001 + rng.normal(0, 1e-4, x.shape)
    wrong = rng.random(x.shape) < 0.4
    # One-sided and structured, as trees before the ground are: a second line, and scatter.
    y[wrong] = np.where(rng.random(wrong.sum()) < 0.5, 0.03 * x[wrong] + 0.004, rng.uniform(0.0, 0.05, wrong.sum()))
    line = robust_line(x, y, seed=seed)
    assert line is not None
    assert line.scale == pytest.approx(0.02, rel=0.01)
    assert line.shift == pytest.approx(-0.001, abs=4e-5)
    assert line.sigma == pytest.approx(1e-4, rel=0.3)
    assert 0.52 < line.inlier_ratio < 0.65
    assert (line.inliers & wrong).sum() < 0.04 * len(x)


def test_weights_decide_whose_error_counts() -> None:
    rng = np.random.default_rng(3)
    x = rng.uniform(1.0, 10.0, 2000)
    y = 3.0 * x + 2.0 + x**2 * rng.normal(0, 0.2, x.shape)
    plain, weighted = robust_line(x, y), robust_line(x, y, weight=1.0 / x**2)
    assert plain is not None
    assert weighted is not None
    assert abs(weighted.shift - 2.0) < 0.1 < abs(plain.shift - 2.0)


def test_no_line_through_too_few_points_or_a_constant() -> None:
    assert robust_line(np.arange(5.0), np.arange(5.0)) is None
    assert robust_line(np.full(50, 0.3), np.arange(50.0)) is None
    assert robust_offset(np.arange(4.0)) is None


def test_an_exact_line_keeps_all_its_points() -> None:
    x = np.linspace(0.0, 1.0, 40)
    line = robust_line(x, 5.0 * x + 1.0, floor=1e-9)
    assert line is not None
    assert line.inlier_ratio == 1.0
    assert (line.scale, line.shift) == (pytest.approx(5.0), pytest.approx(1.0))


def test_an_offset_is_where_most_values_lie() -> None:
    rng = np.random.default_rng(5)
    values = np.concatenate([rng.normal(1.7, 0.05, 600), rng.uniform(2.0, 6.0, 400)])
    offset = robust_offset(values)
    assert offset is not None
    assert offset.shift == pytest.approx(1.7, abs=0.01)
    assert offset.sigma == pytest.approx(0.05, rel=0.35)
