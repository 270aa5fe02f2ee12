"""Sums up trials of poses found in pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_lab.evaluation.pose.pose_trial import PoseTrial

OPEN = 0.5
"""Share of the horizon in view from which on a view counts as open,"""
INSIDE = 0.1
"""and up to which its skyline counts as inside the DEM."""


@dataclass(frozen=True)
class Spread:
    """Median, 90th percentile and maximum of absolute values; NaN of none."""

    median: float
    p90: float
    greatest: float

    @classmethod
    def of(cls, values: Sequence[float] | Float64Array) -> Spread:
        known = np.abs(np.asarray(values, np.float64))
        known = known[np.isfinite(known)]
        if known.size == 0:
            return cls(np.nan, np.nan, np.nan)
        return cls(float(np.median(known)), float(np.percentile(known, 90)), float(known.max()))

    def __str__(self) -> str:
        return f"{self.median:.2f} / {self.p90:.2f} / {self.greatest:.2f}"


@dataclass(frozen=True)
class PoseScore:
    """Of trials: errors in degrees and metres of what was accepted. `z`: 1.48 median |error / sigma| of azimuth, pitch
    and roll, 1 where sigmas are honest. `wrong_by_1`, `wrong_by_2`: accepted with an azimuth off by more degrees.
    """

    trials: int
    accepted: int
    azimuth: Spread
    pitch: Spread
    roll: Spread
    traced: Spread
    traced_before: Spread
    focal_percent: Spread
    z: tuple[float, float, float]
    wrong_by_1: int
    wrong_by_2: int
    verdicts: dict[str, int]
    seconds: Spread

    @classmethod
    def of(cls, trials: Sequence[PoseTrial]) -> PoseScore:
        taken = [trial for trial in trials if trial.accepted]
        errors = np.array([trial.after for trial in taken]).reshape(-1, 3)
        z = np.array([trial.z for trial in taken]).reshape(-1, 3)
        honest = 1.4826 * np.median(np.abs(z), axis=0) if len(z) else np.full(3, np.nan)
        words = [trial.verdict for trial in trials]
        return cls(
            len(trials),
            len(taken),
            Spread.of(errors[:, 0]),
            Spread.of(errors[:, 1]),
            Spread.of(errors[:, 2]),
            Spread.of([trial.traced for trial in taken]),
            Spread.of([trial.traced_before for trial in taken]),
            Spread.of([100 * (trial.focal - 1) for trial in taken]),
            (float(honest[0]), float(honest[1]), float(honest[2])),
            int((np.abs(errors[:, 0]) > 1).sum()),
            int((np.abs(errors[:, 0]) > 2).sum()),
            {word: words.count(word) for word in dict.fromkeys(words)},
            Spread.of([trial.seconds for trial in trials]),
        )


def inside(trials: Sequence[PoseTrial]) -> list[PoseTrial]:
    """Trials whose skyline lies inside the DEM."""
    return [trial for trial in trials if trial.open_share <= INSIDE]


def open_ones(trials: Sequence[PoseTrial]) -> list[PoseTrial]:
    """Trials over most of whose horizon land beyond the DEM may stand."""
    return [trial for trial in trials if trial.open_share >= OPEN]
