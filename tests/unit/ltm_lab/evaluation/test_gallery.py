"""The gallery's measures, worked out by hand, its order, and what it says where data is missing."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
from ltm_lab.evaluation.gallery.exhibit import Exhibit, Fact, Section
from ltm_lab.evaluation.gallery.label_facts import called, facts_of_areas, share_called
from ltm_lab.evaluation.gallery.parts import Part
from ltm_lab.evaluation.gallery.real_photos_io import mountain_names, mountain_sets, require_photos

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


def test_areas_of_sky_alone_say_nothing_of_land() -> None:
    truth = np.full((3, 5), Label.SKY, np.uint8)
    assert math.isnan(facts_of_areas(truth, truth, NAMES)[1])


def test_what_pixels_are_called_names_the_most_frequent_first_and_the_unlabelled_too() -> None:
    labels = np.array([[3, 3, 3, 3, 255, 255, 4, 4, 4, 1]], np.uint8)
    assert called(labels, None, NAMES) == "tree 40%, bare 30%, unlabelled 20%, grass 10%"
    assert called(labels, labels == 9, NAMES) == "nothing"
    assert share_called(labels, labels < 9, (Label.TREE, Label.GRASS)) == pytest.approx(5 / 8)


def test_the_worst_comes_first_and_what_is_not_known_last() -> None:
    photo, labels = np.zeros((2, 3, 3), np.uint8), np.zeros((2, 3), np.uint8)
    faults = {"a": 0.1, "b": math.nan, "c": 0.7, "d": math.nan}
    shown = tuple(Exhibit(name, photo, labels, (), fault) for name, fault in faults.items())
    assert [e.name for e in Section("", "", "", "", shown).worst_first()] == ["c", "a", "b", "d"]


@pytest.mark.parametrize(
    ("fact", "text"),
    [
        (Fact("", 0.1234, "%"), "12.3%"),
        (Fact("", 1.3159, "m"), "1.32 m"),
        (Fact("", 1219), "1,219"),
        (Fact("", math.nan, "m"), "none"),
        (Fact("", "ok"), "ok"),
    ],
)
def test_facts_as_people_write_them(fact: Fact, text: str) -> None:
    assert fact.shown() == text


def test_mountain_photos_train_nothing_and_are_every_second_of_those() -> None:
    sets = mountain_sets()
    assert len(mountain_names()) == 15
    assert {sets.set_of(name) for name in mountain_names()} == {"photos_test"}


def test_missing_data_is_named_with_a_remedy(tmp_path: Path) -> None:
    folder = tmp_path / "engabreen"
    folder.mkdir()
    for name in ("IMG_8902.jpg", "dem_3m_f64.tif", "gcp8902.csv"):
        (folder / name).touch()
    with pytest.raises(ConfigError, match=r"lacks engabreen/IMG_8937.jpg, engabreen/glacier_mask_3m.tif; .*--part"):
        require_photos(tmp_path, (Part.ENGABREEN,))
    with pytest.raises(ConfigError, match=r"lacks hpwren_towers/\*\.jpg, .* and \d+ more"):
        require_photos(tmp_path, (Part.TOWERS, Part.MOUNTAINS))
    (folder / "IMG_8937.jpg").touch()
    (folder / "glacier_mask_3m.tif").touch()
    require_photos(tmp_path, (Part.ENGABREEN,))
