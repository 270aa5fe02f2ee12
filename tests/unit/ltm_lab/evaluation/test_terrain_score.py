import pytest

from ltm_lab.evaluation.metrics.change import ChangeScore
from ltm_lab.evaluation.terrain.hillside_score import HillsideScore, TrialSummary


def scored(change: ChangeScore, before: float, after: float) -> HillsideScore:
    return HillsideScore(change, before, after, None, None)  # type: ignore[arg-type]


def test_the_worst_seed_is_told_beside_the_mean() -> None:
    nan = float("nan")
    summary = TrialSummary.of(
        [
            scored(ChangeScore(80, 20, 20, 880), 4.0, 1.0),
            scored(ChangeScore(60, 0, 40, 900), 4.0, 3.0),
            scored(ChangeScore(0, 0, 0, 1000), nan, nan),
        ]
    )
    assert summary.changed == 200
    assert (summary.precision.mean, summary.precision.worst) == pytest.approx((0.9, 0.8))
    assert (summary.recall.mean, summary.recall.worst) == pytest.approx((0.7, 0.6))
    assert (summary.false_share.mean, summary.false_share.worst) == pytest.approx((0.02 / 3, 0.02))
    assert (summary.ratio.mean, summary.ratio.worst) == pytest.approx((0.5, 0.75))
    assert (summary.rmse_before.mean, summary.rmse_after.mean) == pytest.approx((4.0, 2.0))
