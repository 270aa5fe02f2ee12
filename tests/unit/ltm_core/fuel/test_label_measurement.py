"""Looks learnt from cells of known form: what stands in front of a cell."""

import numpy as np
import pytest
from scenes.evidence_scene import LABELS, visibility, votes

from ltm_core.fuel.cell_appearance_model import SEEN
from ltm_core.fuel.label_measurement import SeenCells, fit_cell_appearance, seen_cells
from ltm_core.fuel.life_form import FORMS, LifeForm, label_forms
from ltm_core.vision.labels import Label

GRASS, TREE = LifeForm.GRASS - 1, LifeForm.TREE - 1


@pytest.mark.parametrize(("bearing", "front"), [(0, [[4, 255, 3], [0, 0, 0]]), (90, [[0, 1, 2], [0, 4, 255]])])
def test_the_cell_in_front_is_the_one_towards_the_camera(bearing: float, front: list[list[int]]) -> None:
    truth = np.array([[1, 2, 3], [4, 255, 3]], np.uint8)
    frame = votes(Label.TREE, visibility=visibility(6, bearing=np.radians(bearing)))
    cells = seen_cells([frame], truth, label_forms(LABELS))
    known = truth != 255
    assert cells.front.tolist() == np.where(np.array(front) > FORMS, 0, front)[known].tolist()
    assert cells.true.tolist() == (truth[known] - 1).tolist()


def test_looks_do_not_repeat_which_forms_follow_each_other() -> None:
    """A form stands behind its own kind in four cells of five, and labels tell it in seven of ten. Labels of the cell
    in front tell of that cell alone, so they are no evidence, though they would guess right in most cells."""
    rng = np.random.default_rng(4)
    true = rng.choice([GRASS, TREE], 20000)
    front = np.where(rng.random(20000) < 0.8, true, GRASS + TREE - true)
    said = np.where(rng.random(20000) < 0.7, true, GRASS + TREE - true)
    seen = np.zeros((20000, SEEN))
    every = np.arange(20000)
    seen[:, 0], seen[every, 1 + said], seen[every, 1 + 2 * FORMS + front] = 1, 1, 1
    cells = SeenCells(every, every, true, front + 1, seen, np.full(20000, 0.5))
    model = fit_cell_appearance([cells])

    def odds(own: int, before: int) -> float:
        look = np.zeros((1, SEEN))
        look[0, [0, 1 + own, 1 + 2 * FORMS + before]] = 1
        told = model.log_likelihood(look, np.array([0.5]))[0]
        return float(told[TREE] - told[GRASS])

    for own in (GRASS, TREE):
        assert odds(own, TREE) == pytest.approx(odds(own, GRASS), abs=0.1)
    assert odds(TREE, TREE) == pytest.approx(np.log(0.7 / 0.3), abs=0.1)
