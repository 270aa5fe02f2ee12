from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes.evidence_scene import ASSUMED
from scenes.fuel_frames import LABELS

from ltm_core.fuel.cell_appearance_model import SEEN, CellAppearanceModel, what_is_seen
from ltm_core.fuel.label_errors import ReliabilityRecord, stated_errors, write_record
from ltm_core.fuel.label_measurement import seen_cells
from ltm_core.fuel.life_form import FORMS, LifeForm, label_forms
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.evaluation.fuel.cell_appearance_io import LearntLook, learn_cell_appearance
from ltm_lab.evaluation.fuel.label_correlation import label_correlation
from ltm_lab.evaluation.fuel.simulated_votes import SimulatedVotes

HEIGHT, WIDTH = 31, 44
GRID = GridGeometry(0.0, 30.0 * HEIGHT, 30.0, WIDTH, HEIGHT)
FORM_IDS = label_forms(LABELS)
TREE, SHRUB, GRASS = LifeForm.TREE - 1, LifeForm.SHRUB - 1, LifeForm.GRASS - 1


def one_hot(*forms: int) -> np.ndarray:
    return np.eye(FORMS)[list(forms)]


def test_neighbours_are_those_along_the_sight() -> None:
    """Three cells in a row from west to east and one south of the first; the sight goes east, then north."""
    rows, cols = np.array([4, 4, 4, 5]), np.array([7, 8, 9, 7])
    shares = one_hot(TREE, SHRUB, GRASS, LifeForm.BARE - 1)
    own, before, behind = slice(1, 8), slice(15, 22), slice(22, 29)
    east = what_is_seen(rows, cols, shares, np.full(4, np.pi / 2), None)
    assert east.shape == (4, SEEN)
    np.testing.assert_array_equal(east[:, own], shares)
    np.testing.assert_array_equal(east[:3, before], one_hot(TREE, TREE, SHRUB))  # the first one's is not seen
    np.testing.assert_array_equal(east[:3, behind], one_hot(SHRUB, GRASS, GRASS))
    north = what_is_seen(rows, cols, shares, np.zeros(4), np.array([0.7, 0.7, 0.7, 0.9]))
    np.testing.assert_array_equal(north[[0, 3]][:, before], one_hot(LifeForm.BARE - 1, LifeForm.BARE - 1))
    np.testing.assert_array_equal(north[[0, 3]][:, behind], one_hot(TREE, TREE))
    np.testing.assert_allclose(north[:, 8:15], shares * [[0], [0], [0], [0.2]], atol=1e-12)


def test_likelihood_between_two_incidences() -> None:
    weights = np.full((FORMS, 2, SEEN), np.nan)
    weights[SHRUB], weights[TREE] = 0.0, 0.0
    weights[TREE, :, 1 + TREE] = 1.0, 3.0  # of the share of pixels called tree
    look = CellAppearanceModel(np.array([0.1, 0.5]), weights)
    seen = what_is_seen(np.array([3]), np.array([5]), one_hot(TREE), np.zeros(1), None)
    for cosine, expected in ((0.0, 1.0), (0.1, 1.0), (0.2, 1.5), (0.5, 3.0), (0.9, 3.0)):
        found = look.log_likelihood(seen, np.array([cosine]))[0]
        assert found[TREE] - found[SHRUB] == pytest.approx(expected)
        assert np.isneginf(np.delete(found, [SHRUB, TREE])).all()


def stands(seed: int) -> np.ndarray:
    """Truth: grass, shrub and tree in blocks of five cells."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(1, 4, (-(-HEIGHT // 5), -(-WIDTH // 5)))
    return np.kron(blocks, np.ones((5, 5), int))[:HEIGHT, :WIDTH].astype(np.uint8)


def seen_from(camera: str, bearing: float, truth: np.ndarray, seed: int) -> CellVotes:
    """A low eye: of a cell's 40 pixels, those of a tree before it are tree; of the others most are right."""
    rng = np.random.default_rng(seed)
    rows, cols = (index.ravel() for index in np.indices(truth.shape))
    before = rows + round(np.cos(bearing)), cols - round(np.sin(bearing))
    inside = (before[0] >= 0) & (before[0] < HEIGHT) & (before[1] >= 0) & (before[1] < WIDTH)
    hidden = inside & (truth[np.where(inside, before[0], 0), np.where(inside, before[1], 0)] == LifeForm.TREE)
    counts = np.zeros((rows.size, len(LABELS)), np.uint32)
    shown = truth[rows, cols]
    right = rng.binomial(40, np.where(rng.random(rows.size) < 0.8, 0.9, 0.4))
    np.add.at(counts, (np.arange(rows.size), shown), right)
    np.add.at(counts, (np.arange(rows.size), rng.integers(1, 4, rows.size)), 40 - right)
    counts[hidden] //= 4
    counts[hidden, LifeForm.TREE] += 30
    flat = np.full(rows.size, 0.1, np.float32)
    visibility = CellVisibility(flat, flat, flat * 0, flat * 0, np.full(rows.size, bearing, np.float32))
    place = rows.astype(np.int32), cols.astype(np.int32)
    return CellVotes(
        GRID, *place, counts, np.zeros(rows.size, np.float32), 10**18 + seed, camera, flat * 0 + 0.7, visibility
    )


def site(seed: int) -> SimulatedVotes:
    truth = stands(seed)
    views = [("north", np.pi), ("west", np.pi / 2), ("north", np.pi), ("west", np.pi / 2)]
    return SimulatedVotes(f"s{seed}", [seen_from(*view, truth, 9 * seed + k) for k, view in enumerate(views)], truth)


@pytest.fixture(scope="module")
def learnt() -> LearntLook:
    return learn_cell_appearance([site(1), site(2)], LABELS)


def test_learnt_looks_see_behind_what_stands_before(learnt: LearntLook) -> None:
    """On a site that taught nothing, cells behind trees are told where most of their labels are wrong."""
    other = site(3)
    cells = seen_cells(other.votes, other.truth, FORM_IDS)
    told = learnt.appearance.log_likelihood(cells.seen, cells.cosine).argmax(axis=1) == cells.true
    voted = cells.seen[:, 1 : 1 + FORMS].argmax(axis=1) == cells.true
    assert told.mean() > voted.mean() + 0.05
    assert not np.isfinite(learnt.appearance.weights[[LifeForm.BARE - 1, LifeForm.WATER - 1]]).any()
    assert [form for form, _, _ in learnt.right] == [1, 2, 3]
    found, _ = label_correlation(
        other.votes, other.truth, FORM_IDS, replace(ASSUMED, appearance=learnt.appearance), 3.0
    )
    assert found.cell == 1.0
    assert found.view < 0.9  # each frame's pixels are drawn anew


def test_a_file_and_back(learnt: LearntLook, tmp_path: Path) -> None:
    appearance = learnt.appearance.as_file()
    record = ReliabilityRecord(source="drawn", network="n", correlation=learnt.correlation, appearance=appearance)
    errors = stated_errors(write_record(record, tmp_path))
    assert errors.appearance is not None
    assert errors.source == "drawn"
    assert errors.correlation == learnt.correlation
    np.testing.assert_allclose(errors.appearance.weights, learnt.appearance.weights, atol=0.006, equal_nan=True)
