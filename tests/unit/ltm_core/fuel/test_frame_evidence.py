from dataclasses import replace

import numpy as np
import pytest
from scenes.evidence_scene import GRID, HOUR, INDEPENDENT, LABELS, NOW, PRIOR, TRUSTED, fuel_map, visibility, votes

from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.frame_evidence import frame_evidence
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.life_form import LifeForm, label_forms
from ltm_core.fuel.rules import FRAME_CAP, FusionRules
from ltm_core.fuel.votes import CellVotes
from ltm_core.vision.labels import Label

pytestmark = pytest.mark.kernel


def test_one_frame_says_at_most_its_cap() -> None:
    layers = fuel_map(votes(Label.TREE, pixels=100_000)).layers()
    np.testing.assert_allclose(layers.evidence, FRAME_CAP, rtol=1e-3)
    assert not layers.changed.any()
    few = fuel_map(votes(Label.TREE, pixels=2)).layers().evidence
    assert (few < 2.01).all()
    assert (few > 1.8).all()


def evidence_of(votes: CellVotes, row: int, col: int) -> np.ndarray:
    """What a frame says of one cell for each life form."""
    frame = frame_evidence(votes, label_forms(LABELS), TRUSTED, FusionRules())
    return np.asarray(frame.amounts[(frame.rows == row) & (frame.cols == col)][0])


def test_labels_are_corrected_by_the_networks_errors() -> None:
    frames = [votes([0, 0, 28, 12, 0, 0, 0], NOW + k * HOUR) for k in range(3)]
    # A network that calls a tenth of shrubs tree has seen shrubs and something else; one that calls three trees of
    # five shrub, and never a shrub tree, has seen trees.
    shares = np.full((7, 7), np.nan)
    shares[1] = 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    shares[2] = 0.0, 0.6, 0.4, 0.0, 0.0, 0.0, 0.0
    for errors, code in ((TRUSTED, 145), (LabelErrors(shares, INDEPENDENT), 165)):
        grid_map = EvidenceMap(GRID, PRIOR, LABELS, FusionRules(support=24.0), errors)
        for frame in frames:
            grid_map.add(frame)
        assert grid_map.layers().code[0, 0] == code


def test_low_confidence_weighs_less() -> None:
    """By the log odds that they are right: labels at even odds tell no form from another, however many pixels."""
    sure, enough, unsure, even = (
        evidence_of(votes(Label.TREE, confidence=c, cells=[(0, 0)]), 0, 0) for c in (0.9, 0.7, 0.6, 0.5)
    )
    np.testing.assert_allclose(sure, enough, rtol=1e-5)
    likelier = [e[LifeForm.TREE - 1] / e[LifeForm.SHRUB - 1] for e in (enough, unsure)]
    odds = np.log(0.6 / 0.4) / np.log(0.7 / 0.3)
    assert 1 < likelier[1] == pytest.approx(likelier[0] ** odds, rel=0.02)
    np.testing.assert_allclose(even[:6], even[0])
    assert even.sum() < enough.sum()


def test_coarse_pixels_weigh_less() -> None:
    coarse = fuel_map(votes(Label.TREE, visibility=visibility(6, footprint=30.0))).layers()
    np.testing.assert_allclose(coarse.evidence, FRAME_CAP / np.sqrt(2), rtol=1e-3)


def test_a_cell_that_may_be_another_one_is_evidence_of_both() -> None:
    cells = [(0, 0), (0, 1), (0, 2)]
    frame = votes(Label.SHRUB, cells=cells)
    frame.counts[2] = [0, 0, 0, 40, 0, 0, 0]
    exact = evidence_of(frame, 0, 1)
    # 30 m sideways (the camera looks north), nothing along: the middle cell may be either neighbour.
    placed = replace(frame, visibility=visibility(3, sigma_across=30))
    spread = evidence_of(placed, 0, 1)
    assert exact[LifeForm.TREE - 1] < 0.1 * exact.sum()
    assert spread[LifeForm.TREE - 1] > 0.15 * spread.sum()
    assert spread.sum() < 0.9 * exact.sum()  # part of where it may lie is not in the frame
    lost = replace(frame, visibility=visibility(3, sigma_along=900))
    assert EvidenceMap(GRID, PRIOR, LABELS).add(lost) is None


def test_context_is_of_the_same_stand_only() -> None:
    """What grows beside a cell in another stand of the prior says nothing of it."""
    frame = votes(Label.SHRUB)
    frame.counts[[0, 1], Label.SHRUB] = 20
    frame.counts[[0, 1], Label.TREE] = 20  # the two shrub stands of the prior, of which the labels are unsure
    of = {}
    for stands in (None, np.array([[1, 1, 2], [3, 4, 5]], np.uint8)):
        evidence = frame_evidence(frame, label_forms(LABELS), TRUSTED, FusionRules(), stands)
        of[stands is None] = evidence.amounts[0] / evidence.amounts[0].sum()
    assert of[True][LifeForm.SHRUB - 1] > of[False][LifeForm.SHRUB - 1] + 0.02
