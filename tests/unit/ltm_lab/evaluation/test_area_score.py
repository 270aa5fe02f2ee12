from __future__ import annotations

import csv

import numpy as np
import pytest

from ltm_core.label_heads.labelled_frames import LAND
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_lab.evaluation.segmentation.area_score import ROLES, Answer, area_score, listed_photos
from ltm_lab.resources import lab_config


def _answer(truth: int, found: list[int], share: float, confidence: float = 0.5) -> Answer:
    labels = np.array(found, np.uint8)
    return Answer("tower", truth, labels, np.full(labels.size, confidence), share)


def test_no_place_is_both_taught_and_tested() -> None:
    with lab_config("training/landscape_photos.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    roles: dict[str, set[str]] = {}
    for row in rows:
        roles.setdefault(row["place"], set()).add(row["role"])
        assert len(row["sha256"]) == 64
        assert len(row["commit"]) == 40
        assert row["licence"]
    assert {len(of_place) for of_place in roles.values()} == {1}
    assert sum(row["role"] == "test" for row in rows) >= len(rows) / 3


@pytest.mark.parametrize("role", ROLES)
def test_areas_lie_in_their_photos_and_overlap_none_of_another_class(role: str) -> None:
    for photo in listed_photos(role):
        of_class: dict[int, np.ndarray] = {}
        for k, (label, _) in enumerate(photo.areas):
            of_class[label] = of_class.get(label, np.zeros((200, 300), bool)) | (photo.drawn(k, 200, 300) > 0)
        assert np.max(np.sum(list(of_class.values()), axis=0)) == 1
        assert all(0 <= v <= 1 for _, polygon in photo.areas for corner in polygon for v in corner)


def test_every_photo_counts_by_the_share_of_its_areas() -> None:
    score = area_score(
        [
            _answer(Label.TREE, [Label.TREE, Label.SHRUB], 0.3),
            _answer(Label.SKY, [Label.SKY] * 9 + [UNLABELLED], 0.1),
            _answer(LAND, [Label.SKY, Label.BARE, Label.WATER, Label.TREE], 0.1),
        ]
    )
    assert score.areas == 2
    assert score.right == pytest.approx((0.3 * 0.5 + 0.1 * 0.9) / 0.4)
    assert score.at_80 == 0.5
    assert score.unlabelled == pytest.approx(0.01 / 0.4)
    assert score.tree_as_shrub == 0.5
    assert score.land_as_sky_or_water == pytest.approx(0.05 / 0.4)
