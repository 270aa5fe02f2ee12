from pathlib import Path

import numpy as np
import pytest

from ltm_core.fuel.label_drift import FIRST_WEEKS, LIMIT, WEEK_NS, LabelDrift, drift_sigmas
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.vision.labels import LabelSet

GRID = GridGeometry(0.0, 60.0, 30.0, 2, 2)
FALL_WEEK = 36


def seasonal(seed: int, amplitude: float, weeks: int = 104, fall: float = 0.0) -> list[float]:
    """Weekly shares with a season of random phase and correlated weather; `fall`: drift from FALL_WEEK on."""
    rng = np.random.default_rng(seed)
    time, weather = np.arange(weeks), np.zeros(weeks)
    for week in range(1, weeks):
        weather[week] = 0.6 * weather[week - 1] + 0.8 * 0.02 * rng.standard_normal()
    season = amplitude * np.cos(2 * np.pi * time / 52 + rng.uniform(0, 2 * np.pi))
    return (0.85 + season + weather - fall * (time >= FALL_WEEK)).tolist()


@pytest.mark.parametrize("amplitude", [0.0, 0.03, 0.06, 0.1])
def test_no_alarm_in_seasonal_years(amplitude: float) -> None:
    for seed in range(12):
        shares = seasonal(seed, amplitude)
        assert min(drift_sigmas(shares[:week]) for week in range(1, len(shares) + 1)) > -LIMIT, seed


@pytest.mark.parametrize(("amplitude", "fall"), [(0.0, 0.2), (0.03, 0.25)])
def test_a_fall_that_matters_alarms_within_four_weeks(amplitude: float, fall: float) -> None:
    for seed in range(12):
        shares = seasonal(seed, amplitude, FALL_WEEK + 4, fall)
        assert any(drift_sigmas(shares[:week]) < -LIMIT for week in range(FALL_WEEK + 1, len(shares) + 1)), seed


def votes(week: int, shrub: int, tree: int, row: int = 0, col: int = 0) -> CellVotes:
    labels = LabelSet.load()
    counts = np.zeros((1, len(labels)), np.uint32)
    counts[0, [labels.names.index("shrub"), labels.names.index("tree"), 0]] = shrub, tree, 999  # sky says nothing
    place = np.array([row], np.int32), np.array([col], np.int32)
    return CellVotes(GRID, *place, counts, np.zeros(1, np.float32), week * WEEK_NS + 5, "north")


def watched(file: Path | None = None) -> LabelDrift:
    drift = LabelDrift(LabelSet.load(), file)
    drift.set_reference(np.full((2, 2), 2, np.uint8), np.array([[True, False], [True, True]]), 0)
    return drift


def test_the_share_of_a_week_is_the_mean_over_its_frames_in_unchanged_cells() -> None:
    drift = watched()
    for frame in (votes(0, 900, 100), votes(0, 500, 500), votes(0, 0, 1000, col=1), votes(0, 1, 100)):
        assert not drift.take(frame)  # the third lies in a changed cell, the fourth has too few pixels
    assert drift.weeks() == {}
    assert drift.take(votes(1, 900, 100))
    assert drift.weeks() == {"north": pytest.approx((0.7,))}
    assert not drift.take(votes(0, 0, 1000)), "late"


def test_charts_survive_a_restart_and_end_with_the_network(tmp_path: Path) -> None:
    file = tmp_path / "drift.json"
    for week in range(FIRST_WEEKS + 8):
        drift = watched(file)  # a new process each week
        drift.take(votes(week, *((850, 150) if week < FIRST_WEEKS + 3 else (400, 600))), "network a")
        drift.save()
    assert drift.weeks()["north"][-1] == pytest.approx(0.4)
    assert drift_sigmas(drift.weeks()["north"]) < -LIMIT
    assert "north" in drift.problem()
    drift.take(votes(FIRST_WEEKS + 8, 400, 600), "network b")
    assert drift.problem() == ""
    assert drift.weeks() == {}
