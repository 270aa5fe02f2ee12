import json
from dataclasses import dataclass
from pathlib import Path

import pytest
from rich.console import Console

from ltm_lab.cli.eval.trial_runner import report, run_trials


@dataclass(frozen=True)
class Row:
    name: str
    error: float


@pytest.mark.parametrize("processes", [1, 2])
def test_rows_come_in_the_order_of_the_jobs(processes: int) -> None:
    assert run_trials(range, [3, 0, 2], processes, Console(quiet=True)) == [0, 1, 2, 0, 1]
    with pytest.raises(TypeError):
        run_trials(range, [3, "x"], processes, Console(quiet=True))  # type: ignore[arg-type]


def test_rows_and_figures_are_written(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    report(Console(quiet=True), "two trials", [Row("a", 1.5), Row("b", float("nan"))], path, turn_deg=2.0)
    assert json.loads(path.read_text()) == {
        "conditions": "two trials",
        "turn_deg": 2.0,
        "trials": [{"name": "a", "error": 1.5}, {"name": "b", "error": None}],
    }
