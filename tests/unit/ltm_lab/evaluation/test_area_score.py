import csv
import json
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from ltm_core.label_heads.labelled_frames import LAND, UNKNOWN
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_lab.cli import main
from ltm_lab.evaluation.segmentation.area_score import ROLES, Answer, area_score, listed_photos, regions
from ltm_lab.resources import lab_config
from ltm_lab.training.statements import absent, rows_of, stated
from ltm_lab.training.training_frames import read_training_frames


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
        assert len(row["commit"]) == 40 or row["repo"].startswith("debian/")
        assert row["licence"]
    assert {len(of_place) for of_place in roles.values()} == {1}
    assert sum("train" not in of_place for of_place in roles.values()) >= len(roles) / 3
    taught = {row["id"] for row in rows if row["role"] == "train"}
    assert taught == {row["id"] for row in rows if row["absent"]}
    assert all(stated(rows_of(row["absent"], 90)).all() for row in rows)


@pytest.mark.parametrize("role", ROLES)
def test_areas_lie_in_their_photos_and_overlap_none_of_another_class(role: str) -> None:
    for photo in listed_photos(role):
        of_class: dict[int, np.ndarray] = {}
        for k, (label, _) in enumerate(photo.areas):
            of_class[label] = of_class.get(label, np.zeros((200, 300), bool)) | (photo.drawn(k, 200, 300) > 0)
        assert np.max(np.sum(list(of_class.values()), axis=0), initial=0) <= 1
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


def test_areas_and_statements_of_a_list_become_labels_to_train_on(tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text("id,kind,role,absent\n7,alps,train,water sky:75\n8,alps,test,\n")
    areas = [{"photo": photo, "class": "sky", "polygon": [[0, 0], [1, 0], [1, 0.5], [0, 0.5]]} for photo in "78"]
    (tmp_path / "landscape_areas.json").write_text(json.dumps(areas))
    cv2.imwrite(str(tmp_path / "7.jpg"), np.random.default_rng(1).integers(0, 255, (60, 80, 3), np.uint8))
    command = ["train", "photos", str(tmp_path / "mine.csv"), "--images", str(tmp_path), "--out", str(tmp_path / "o")]
    result = CliRunner().invoke(main.cli, command)
    assert result.exit_code == 0, result.output
    labels = cv2.imread(str(next((tmp_path / "o").rglob("7_labels.png"))), cv2.IMREAD_UNCHANGED)
    assert {path.parent.name for path in (tmp_path / "o").rglob("*_labels.png")} == {"areas_train"}
    assert (labels[:29] == Label.SKY).all()
    assert (labels[31:] == UNKNOWN).all()
    (frame,) = read_training_frames(tmp_path / "o" / "areas_train", 7)
    assert (frame.labels[:29] == Label.SKY).all()
    assert {absent(label) for label in frame.labels[31:44].ravel()} == {(Label.WATER,)}
    assert {absent(label) for label in frame.labels[45:].ravel()} == {(Label.SKY, Label.WATER)}


def test_regions_of_a_photo_are_enlarged_to_its_size_and_unknown_elsewhere(tmp_path: Path) -> None:
    table = tmp_path / "mine.csv"
    assert (regions(table, "7", 4, 6) == UNKNOWN).all()
    drawn = np.array([[Label.SKY, Label.TREE], [LAND, UNKNOWN]], np.uint8)
    with zipfile.ZipFile(tmp_path / "landscape_labels.zip", "w") as file:
        file.writestr("7.png", cv2.imencode(".png", drawn)[1].tobytes())
    assert regions(table, "7", 4, 6).tolist() == drawn.repeat(2, axis=0).repeat(3, axis=1).tolist()
    assert (regions(table, "8", 4, 6) == UNKNOWN).all()
