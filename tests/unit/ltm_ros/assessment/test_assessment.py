"""From a map to its report: what interpreters see, what counts, and that the figures are those of the answers."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.class_map import read_fuel_map
from ltm_core.site.site_io import load_site
from ltm_ros.assessment.answers_io import FORM_NAMES, Answer, SampledCell, write_answers
from ltm_ros.assessment.figures import compute_figures
from ltm_ros.assessment.plan import NAMES, MapPlan, read_map_plan, with_map
from ltm_ros.assessment.report import keep_accuracy
from ltm_ros.cli.main import cli
from ltm_ros.fuel_map.source import FuelSource

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
    return Answer(cell, form, "sure" if form else "cannot_be_seen", 5.0, "2026-11-29T00:00:00Z")


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
    assert len(figures.cells) == 90 - 5 - 2 + 1
    assert (figures.unanswered, figures.hidden, figures.learned, figures.plots) == (10, 4, 2, 1)
    assert figures.right.sum() == len(figures.cells) - 1
    assert [(a.name, a.cells, a.share, a.kappa) for a in figures.agreements] == [("b", 15, 1.0, 1.0)]


def test_the_same_answers_assess_another_map_in_the_plans_strata(plan: MapPlan) -> None:
    """In the other map all grass is shrub: overall accuracy is the true share of what is not grass."""
    write_answers(plan.shown.answers_file("first"), [answer(c.cell, true_form(c)) for c in plan.shown.cells])
    grass, shrub = NAMES.index("grass"), NAMES.index("shrub")
    with FuelSource.open(DEMO / "fuel_truth.tif", load_site(DEMO / "site.yaml")) as source:
        forms = source.layers.life_form
        other = replace(source, layers=replace(source.layers, life_form=np.where(forms == grass, shrub, forms)))
        assessed = with_map(plan, other, DEMO / "other.tif")
        shifted = replace(source.geometry, x_min=source.geometry.x_min + 30)
        with pytest.raises(ConfigError, match=r"other\.tif"):
            with_map(plan, replace(source, geometry=shifted), DEMO / "other.tif")
    assert assessed.about["map"]["sha256"] != plan.about["map"]["sha256"]
    found = compute_figures(assessed, None).map
    true = float((forms[plan.map.observed] != grass).mean())
    assert found.overall.value == pytest.approx(true)  # grass is a stratum of its own
    assert found.overall.low < true < found.overall.high


def test_no_answers_is_an_error(plan: MapPlan) -> None:
    with pytest.raises(ConfigError, match="0"):
        compute_figures(plan, None)


def test_the_map_of_a_plan_is_that_of_its_day(plan: MapPlan) -> None:
    observed = plan.map.observed
    for cell in plan.shown.cells:
        stratum = plan.strata[plan.stratum[cell.cell]]
        assert observed[cell.row, cell.column]
        assert plan.map.life_form[cell.row, cell.column] == stratum.map_class
        assert plan.map.changed[cell.row, cell.column] == stratum.changed
    assert sum(s.cells for s in plan.strata) == np.count_nonzero(observed)


def test_a_damaged_or_smaller_map_of_a_plan_is_rejected(plan: MapPlan) -> None:
    path = plan.shown.folder / "map.npz"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(ConfigError, match=r"map\.npz"):
        read_map_plan(plan.shown.folder)
    np.savez_compressed(path, **{name: layer[1:] for name, layer in vars(plan.map).items()})
    with pytest.raises(ConfigError, match=r"map\.npz"):
        read_map_plan(plan.shown.folder)


def test_exports_of_an_assessed_map_carry_its_accuracy(plan: MapPlan, tmp_path: Path) -> None:
    write_answers(plan.shown.answers_file("first"), [answer(c.cell, true_form(c)) for c in plan.shown.cells])
    store = tmp_path / "fuel_map.ltm"
    store.touch()
    assessed = replace(plan, about=plan.about | {"map": plan.about["map"] | {"path": str(store)}})
    figures = compute_figures(assessed, None)
    with FuelSource.open(DEMO / "fuel_truth.tif", load_site(DEMO / "site.yaml")) as source:
        of_store = replace(source, folder=tmp_path)
        assert "accuracy" not in of_store.provenance(source.layers, None).tags()
        keep_accuracy(assessed, figures)
        tag = of_store.provenance(source.layers, None).tags()["accuracy"]
    assert "100.0 %" in tag
    assert f"{len(figures.cells)} observed cells" in tag
