"""Summaries of smoke trials: error, coverage of the regions, cameras that were named."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ltm_lab.evaluation.locating.smoke_score import Trial


@dataclass(frozen=True)
class SmokeSummary:
    """Of trials of one kind. Shares are of all, an answer that was refused counts as a miss; errors are of those with
    one. `densest_50`, `densest_95`: how often the densest region held the foot; `ellipse_50`, `ellipse_95`: an ellipse.
    `long`: median half axis of the 95 % ellipse. `agreed`: cameras that were taken for agreeing. `named`: the wrong
    camera was named; `wrongly_named`: one that was not wrong.
    """

    count: int
    unlocated: int
    range: float
    error: float
    error_share: float
    likeliest_error: float
    likeliest_share: float
    error_p90: float
    densest_50: float
    densest_95: float
    ellipse_50: float
    ellipse_95: float
    long: float
    short: float
    agreed: float
    named: float
    wrongly_named: float
    milliseconds: float

    @classmethod
    def of(cls, trials: Sequence[Trial]) -> SmokeSummary | None:
        """None of no trials."""
        if not trials:
            return None
        found = [trial for trial in trials if not trial.unlocated]

        def middle(values: Sequence[float], at: float = 50.0) -> float:
            return float(np.percentile(values, at)) if values else math.nan

        def share(values: Sequence[bool]) -> float:
            return float(np.mean(values)) if values else math.nan

        turned = [trial for trial in trials if trial.wrong]
        return cls(
            len(trials),
            len(trials) - len(found),
            middle([trial.range for trial in trials]),
            middle([trial.error for trial in found]),
            middle([trial.error / trial.range for trial in found]),
            middle([trial.likeliest_error for trial in found]),
            middle([trial.likeliest_error / trial.range for trial in found]),
            middle([trial.error for trial in found], 90.0),
            share([trial.densest < 0.5 for trial in trials]),
            share([trial.densest < 0.95 for trial in trials]),
            share([trial.in_50 for trial in trials]),
            share([trial.in_95 for trial in trials]),
            middle([trial.major for trial in found]),
            middle([trial.minor for trial in found]),
            share([trial.agreed for trial in found]),
            share([trial.named == trial.wrong for trial in turned]),
            share([bool(trial.named) and trial.named != trial.wrong for trial in trials]),
            middle([trial.milliseconds for trial in found]),
        )

    def row(self) -> dict[str, Any]:
        """For JSON."""
        return {key: value if value == value else None for key, value in asdict(self).items()}
