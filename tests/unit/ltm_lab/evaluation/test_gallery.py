from __future__ import annotations

import numpy as np
import pytest

from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
from ltm_lab.evaluation.gallery.exhibit import Fact
from ltm_lab.evaluation.gallery.label_facts import facts_of_areas

NAMES = LabelSet.load().names


def _value(facts: list[Fact], name: str) -> object:
    return next(fact.value for fact in facts if fact.name == name)


def test_sky_does_not_hide_what_is_wrong_on_land() -> None:
    truth = np.full((6, 10), Label.SKY, np.uint8)
    truth[4] = Label.SHRUB
    truth[5] = UNLABELLED
    labels = truth.copy()
    labels[4, :7] = Label.TREE
    labels[5] = Label.WATER  # where nobody has said anything
    facts, wrong = facts_of_areas(labels, truth, NAMES)
    assert wrong == pytest.approx(0.7)
    assert _value(facts, "right, of the land named by hand") == pytest.approx(0.3)
    assert _value(facts, "right, of the sky named by hand") == 1.0
    assert _value(facts, "F1 shrub") == pytest.approx(2 * 3 / (10 + 3))
    assert _value(facts, "shrub by hand (10 px) is called") == "tree 70%, shrub 30%"
