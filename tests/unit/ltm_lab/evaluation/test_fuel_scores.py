import json
from pathlib import Path

import numpy as np
import pytest
from scenes.fuel_frames import BEGIN_NS, LABELS, NAME, grid_of, write_site
from typer.testing import CliRunner

from ltm_core.fuel.class_map import write_fuel_map
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors
from ltm_core.fuel.life_form import NODATA, LifeForm
from ltm_core.fuel.votes import CellVotes
from ltm_core.scoring.fuel import score_map
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import Label
from ltm_lab.cli.main import cli
from ltm_lab.evaluation.dated_run import DatedRun
from ltm_lab.evaluation.fuel.trial_score import users_accuracy
from ltm_lab.evaluation.fuel_score import score_fuel_bag
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.pointcloud import votes_to_msg


def test_what_a_map_found_and_what_it_invented() -> None:
    prior = np.array([[145, 145, 145, 102, 121], [145, 165, NODATA, 91, 145]], np.int16)
    truth = np.array([[2, 3, 3, 1, 2], [2, 3, 1, 6, 255]], np.uint8)
    mapped = np.array([[2, 3, 2, 3, 2], [1, 3, 2, 6, 2]], np.uint8)
    seen = np.ones((2, 5), bool)
    seen[1, 1] = False
    score = score_map("ours", mapped, truth, prior, seen)
    assert (score.right.count, score.right.of) == (4, 8)  # all but one unseen and one of no truth
    assert (score.found.count, score.found.of) == (1, 2)
    # Of five cells that still are what the prior says and one without any prior: grass to tree, shrub to grass.
    assert (score.false_flips.count, score.false_flips.of) == (2, 6)
    right, false = score.by_form["shrub"]
    assert (right.count, right.of, false.count, false.of) == (2, 3, 1, 3)
    assert "water" not in score.by_form


def test_the_accuracy_of_reported_changes_at_any_prevalence() -> None:
    """Ten cells of shrub, four of them felled: two found, one called grass, one missed; one of the others reported."""
    prior = np.full((2, 5), 145, np.int16)
    truth = np.array([[3, 3, 3, 3, 2], [2, 2, 2, 2, 2]], np.uint8)
    mapped = np.array([[3, 3, 1, 2, 1], [2, 2, 2, 2, 2]], np.uint8)
    score = score_map("ours", mapped, truth, prior, np.ones((2, 5), bool))
    assert (score.found.count, score.mistaken.count, score.false_flips.of) == (2, 1, 6)
    assert score.prevalence == 0.4
    assert users_accuracy(score) == pytest.approx(2 / 4)
    assert users_accuracy(score, 0.01) == pytest.approx(0.005 / (0.01 * 0.75 + 0.99 / 6))
    silent = score_map("prior", np.full((2, 5), 2, np.uint8), truth, prior, np.ones((2, 5), bool))
    assert np.isnan(users_accuracy(silent, 0.01))


def test_odds_that_a_label_shows_open_ground() -> None:
    """Of a patch worth 2 / (1 + 0.5) cells, grass and bare ground as likely as shrubs and trees."""
    shares = np.eye(len(LifeForm))
    shares[:4, :4] = [[0.7, 0.1, 0.1, 0.1], [0.2, 0.6, 0.2, 0.0], [0.0, 0.2, 0.8, 0.0], [0.1, 0.2, 0.1, 0.6]]
    correlation = LabelCorrelation(cell=0.8, stand=0.4, view=0.5, network=0.1)
    odds = LabelErrors(shares, correlation).open_odds()
    # A share of none counts as one in a hundred.
    expected = np.log([0.4 / 0.105, 0.15 / 0.4, 0.1 / 0.5, 0.35 / 0.01]) * 2 / 1.5
    np.testing.assert_allclose(odds[1:5], expected, atol=1e-6)
    assert not odds[5:].any()
    assert odds[0] == 0
    shares[1] = np.nan
    assert not LabelErrors(shares, correlation).open_odds().any()


@pytest.fixture
def recorded(tmp_path: Path) -> DatedRun:
    """Two towers that see the same slope twice: trees where there is no prior, a third of it grass in truth."""
    site = write_site(tmp_path)
    grid = grid_of(site)
    rows, cols = (index.ravel().astype(np.int32) for index in np.mgrid[5:25, 7:31])
    truth = np.full(grid.shape, 3, np.uint8)
    truth[5:25, 7:15] = 1
    write_fuel_map(tmp_path / "fuel_truth.tif", truth, load_site(site).in_crs(grid), LABELS)
    with BagWriter(tmp_path / "recording") as bag:
        for second in range(2):
            for camera in ("north", "east"):
                counts = np.zeros((len(rows), len(LABELS)), np.uint32)
                counts[:, Label.TREE] = 30
                stamp = BEGIN_NS + second * 10**9
                votes = CellVotes(grid, rows, cols, counts, np.zeros(len(rows), np.float32), stamp, camera)
                bag.write(f"/{NAME}/{camera}/fuel/votes", votes_to_msg(votes, LABELS.names), stamp)
    return DatedRun.find(tmp_path / "recording", site)


def test_a_recording_scored(recorded: DatedRun, tmp_path: Path) -> None:
    score = score_fuel_bag(recorded, 0.1)
    assert score.frames == 4
    assert [found.name for found in score.maps] == [
        "evidence",
        "evidence, 0.1 h of the same frames",
        "the paper's vote",
    ]
    for found in score.maps:
        assert (found.right.count, found.right.of) == (20 * 16, 20 * 24)
    assert score.unjustified == 0
    assert score.cells is not None
    assert score.cells[0, 2] == 4 * 20 * 8
    figures = tmp_path / "figures.json"
    result = CliRunner().invoke(cli, ["eval", "fuel", str(recorded.bag), "--json", str(figures)])
    assert result.exit_code == 0, result.output
    assert "cells of grass are mostly labelled tree 100%" in result.output
    assert json.loads(figures.read_text())["maps"][0]["right"] == pytest.approx(2 / 3)
