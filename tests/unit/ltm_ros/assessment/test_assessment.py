from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.class_map import read_fuel_map
from ltm_ros.assessment.answers_io import FORM_NAMES, Answer, SampledCell, write_answers
from ltm_ros.assessment.figures import compute_figures
from ltm_ros.assessment.plan import MapPlan, read_map_plan
from ltm_ros.cli.main import cli

DEMO = Path(__file__).parents[4] / "bags/demo"


@pytest.fixture
def plan(tmp_path: Path) -> MapPlan:
    """The plan of the demo's true map: of a map without an error."""
    arguments = ["assess", "plan", str(DEMO / "fuel_truth.tif"), "--site", str(DEMO / "site.yaml"), "--cells", "100"]
    made = CliRunner().invoke(cli, [*arguments, "--out", str(tmp_path / "plan")], catch_exceptions=False)
    assert made.exit_code == 0, made.output
    with pytest.raises(ConfigError):  # a second plan would part answers from their cells
        CliRunner().invoke(cli, [*arguments, "--out", str(tmp_path / "plan")], catch_exceptions=False)
    return read_map_plan(tmp_path / "plan")


def true_form(cell: SampledCell) -> str:
    classes, grid = read_fuel_map(DEMO / "fuel_truth.tif")
    row, column = grid.cell_of(cell.x, cell.y)
    return FORM_NAMES[classes[int(row), int(column)] - 1]


def answer(cell: int, form: str) -> Answer:
    return Answer(cell, form, "sure" if form else "cannot_be_seen", None, 5.0, "2026-11-29T00:00:00Z")


def test_true_answers_give_a_right_map_and_a_page(plan: MapPlan, tmp_path: Path) -> None:
    with (plan.shown.folder / "cells.csv").open() as table:
        assert csv.DictReader(table).fieldnames == ["cell", "row", "column", "lon", "lat", "x", "y"]
    write_answers(plan.shown.answers_file("first"), [answer(c.cell, true_form(c)) for c in plan.shown.cells])
    out = tmp_path / "report.html"
    made = CliRunner().invoke(cli, ["assess", "report", str(plan.shown.folder), "--out", str(out)])
    assert made.exit_code == 0, made.output
    assert out.read_text().count("data:image/png") == 3
    figures = json.loads(out.with_suffix(".json").read_text())
    assert figures["map"]["overall"]["value"] == 1
    assert 0.9 < figures["map"]["overall"]["low"] < 1
    classes, _ = read_fuel_map(DEMO / "fuel_truth.tif")
    before = plan.map.prior_form
    right = float((before == classes)[plan.map.observed].mean())
    assert figures["prior_map"]["overall"]["low"] <= right <= figures["prior_map"]["overall"]["high"]


def test_hidden_learned_and_missing_cells_do_not_count_and_plots_replace_answers(plan: MapPlan, tmp_path: Path) -> None:
    cells = plan.shown.cells
    forms = ["" if k < 5 else true_form(c) for k, c in enumerate(cells[:90])]
    write_answers(plan.shown.answers_file("a"), [answer(c.cell, f) for c, f in zip(cells[:90], forms, strict=True)])
    other = [answer(c.cell, true_form(c)) for c in cells[:20]]
    write_answers(plan.shown.answers_file("b"), other)
    (plan.shown.folder / "learned.csv").write_text(f"cell\n{cells[10].cell}\n{cells[11].cell}\n")
    plot = tmp_path / "plots.csv"
    plot.write_text(f"lon,lat,life form,date\n{cells[0].lon},{cells[0].lat},water,2026-05-01\n")
    figures = compute_figures(plan, plot)
    assert len(figures.rows) == 90 - 5 - 2 + 1
    assert (figures.unanswered, figures.hidden, figures.learned, figures.plots) == (10, 4, 2, 1)
    assert figures.right(plan).sum() == len(figures.rows) - 1
    assert [(a.name, a.cells, a.share, a.kappa) for a in figures.agreements] == [("b", 15, 1.0, 1.0)]


def test_the_map_of_a_plan_is_that_of_its_day(plan: MapPlan) -> None:
    observed = plan.map.observed
    for cell in plan.shown.cells:
        stratum = plan.strata[plan.stratum[cell.cell]]
        assert observed[cell.row, cell.column]
        assert plan.map.life_form[cell.row, cell.column] == stratum.map_class
        assert plan.map.changed[cell.row, cell.column] == stratum.changed
    assert sum(s.cells for s in plan.strata) == np.count_nonzero(observed)
