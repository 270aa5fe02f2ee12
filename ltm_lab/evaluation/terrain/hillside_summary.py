"""Summary of the trials of one hillside scene over several seeds: mean and worst value of each score."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean

from ltm_lab.evaluation.terrain.hillside_score import HillsideScore


@dataclass(frozen=True)
class Spread:
    """Over seeds; NaN where no seed has a value."""

    mean: float
    worst: float


@dataclass(frozen=True)
class TrialSummary:
    """`changed`: truly changed cells that were seen, of all seeds. `ratio`: of the RMSE after to that before."""

    seeds: int
    changed: int
    covered: float
    precision: Spread
    recall: Spread
    false_share: Spread
    away_share: Spread
    rmse_before: float
    rmse_after: float
    ratio: Spread

    @classmethod
    def of(cls, scores: Sequence[HillsideScore]) -> TrialSummary:
        """Summarise the scores of one trial or more."""
        return cls(
            len(scores),
            sum(score.change.hits + score.change.misses for score in scores),
            _mean([score.covered for score in scores]),
            _spread([score.change.precision for score in scores], min),
            _spread([score.change.recall for score in scores], min),
            _spread([score.false_share for score in scores], max),
            _spread([score.away_share for score in scores], max),
            _mean([score.rmse_before for score in scores]),
            _mean([score.rmse_after for score in scores]),
            _spread([score.rmse_after / score.rmse_before for score in scores], max),
        )


def _known(values: Sequence[float]) -> list[float]:
    return [value for value in values if value == value]


def _mean(values: Sequence[float]) -> float:
    known = _known(values)
    return fmean(known) if known else float("nan")


def _spread(values: Sequence[float], worst: Callable[[Sequence[float]], float]) -> Spread:
    known = _known(values)
    return Spread(_mean(known), worst(known)) if known else Spread(float("nan"), float("nan"))
