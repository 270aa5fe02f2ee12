"""Label heads of a label network: none is none to the bit, what a label head adds is its formula, a wrong file is
refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scenes.networks import COLORS, changed, write_classifier, write_swapping_head

from ltm_core.base.errors import ModelError
from ltm_core.fuel.label_errors import known_errors
from ltm_core.fuel.life_form import LifeForm
from ltm_core.vision.label_head import (
    LabelHead,
    find_label_head,
    label_heads_folder,
    read_label_head,
)
from ltm_core.vision.label_rules import LabelAgreement
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.manifest import SHIPPED_LABEL_HEAD, NetworkManifest, Withdrawal
from ltm_core.vision.segmenter import Segmenter


def _photo() -> np.ndarray[Any, np.dtype[np.uint8]]:
    rng = np.random.default_rng(3)
    small = rng.integers(0, 256, (9, 14, 3), np.uint8)
    return np.asarray(cv2.resize(small, (251, 117), interpolation=cv2.INTER_CUBIC), np.uint8)


def test_agreement_changes_how_sure_labels_are_and_not_the_labels() -> None:
    manifest = Segmenter.open().manifest
    zeros = {name: np.zeros((len(manifest.classes), count), np.float32) for name, count in manifest.maps.items()}
    head = LabelHead("a", "a", zeros, np.zeros(len(manifest.classes), np.float32), 1.0, Withdrawal(confidence=0.5))
    photo = _photo()
    alone = Segmenter(manifest, head=head).segment(photo)
    around = Segmenter(manifest, head=replace(head, agreement=LabelAgreement(reach=0.02))).segment(photo)
    np.testing.assert_array_equal(around.labels, alone.labels)
    unlabelled = around.labels == UNLABELLED
    assert 0 < unlabelled.mean() < 1
    assert not around.confidence[unlabelled].any()
    assert around.confidence[~unlabelled].mean() < alone.confidence[~unlabelled].mean()
    assert (around.confidence[~unlabelled] < 0.8 * alone.confidence[~unlabelled]).any()


def test_what_a_head_adds_is_its_weights_times_the_enlarged_maps() -> None:
    rng = np.random.default_rng(5)
    scores = rng.normal(size=(3, 8, 12)).astype(np.float32)
    fine, coarse = (rng.normal(size=shape).astype(np.float32) for shape in ((4, 8, 12), (5, 4, 6)))
    weights = {"fine": rng.normal(size=(3, 4)), "coarse": rng.normal(size=(3, 5))}
    bias = np.array([0.5, -1.0, 2.0], np.float32)
    head = LabelHead("h", "h", {k: w.astype(np.float32) for k, w in weights.items()}, bias, 1.0)
    found = scores.copy()
    head.add_to(found, [fine, coarse])
    enlarged = np.stack([cv2.resize(plane, (12, 8), interpolation=cv2.INTER_LINEAR) for plane in coarse])
    expected = scores + bias[:, None, None]
    expected += np.einsum("kc,chw->khw", weights["fine"], fine) + np.einsum("kc,chw->khw", weights["coarse"], enlarged)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    with pytest.raises(ModelError, match="coarse"):
        head.add_to(found, [fine, fine])


def test_a_head_changes_the_labels_of_who_names_it_alone(tmp_path: Path) -> None:
    manifest = write_classifier(tmp_path, maps=True)
    write_swapping_head(tmp_path / "heads" / "swap.yaml", manifest)
    photo = np.full((40, 70, 3), COLORS["lime"], np.uint8)
    photo[:, :20] = COLORS["red"]
    plain = Segmenter.open(manifest, heads=tmp_path / "heads")
    swapped = Segmenter.open(manifest, head="swap", heads=tmp_path / "heads")
    assert (plain.segment(photo).labels[20, 5], plain.segment(photo).labels[20, 60]) == (Label.BUILT, Label.GRASS)
    assert (swapped.segment(photo).labels[20, 5], swapped.segment(photo).labels[20, 60]) == (Label.GRASS, Label.BUILT)
    assert swapped.described.startswith(f"{plain.described}, label head swap ")
    assert swapped.name == "colors swap"


def test_a_head_is_found_in_the_site_s_folder_then_beside_the_network(tmp_path: Path) -> None:
    path = write_classifier(tmp_path, maps=True)
    manifest = NetworkManifest.load(path)
    assert find_label_head(SHIPPED_LABEL_HEAD, manifest) is None
    beside = write_swapping_head(label_heads_folder(manifest, tmp_path) / "swap.yaml", path)
    assert find_label_head("swap", manifest) == beside
    own = write_swapping_head(tmp_path / "site" / "swap.yaml", path)
    assert find_label_head("swap", manifest, tmp_path / "site") == own
    assert find_label_head("swap.yaml", manifest, tmp_path / "site") == own
    with pytest.raises(ModelError, match=r"no label head 'sand'.*site/sand\.yaml.*colors_heads/sand\.yaml"):
        find_label_head("sand", manifest, tmp_path / "site")


def test_a_head_of_another_network_is_refused(tmp_path: Path) -> None:
    manifest = write_classifier(tmp_path, maps=True)
    head = write_swapping_head(tmp_path / "swap.yaml", manifest)
    (tmp_path / "other").mkdir()
    other = write_classifier(tmp_path / "other", maps=True, gain=50.0)
    with pytest.raises(ModelError, match=r"is a label head of network 'colors' with sha256.*ltm train head"):
        read_label_head(head, NetworkManifest.load(other))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"maps": {"mean": [[0.0, 1.0, 2.0]] * 4}}, "expected 5 rows"),
        ({"maps": {"mean": [[0.0, 1.0]] * 5}}, r"mean \(2, not 3\)"),
        ({"maps": {"mean": [[0.0, 1.0, 2.0]] * 4 + [[0.0, 1.0]]}}, "as many numbers"),
        ({"maps": {"s9": [[0.0]] * 5}}, "reads map s9"),
        ({"bias": [0.0] * 4}, "bias has 4 values"),
        ({"classes": ["a", "b", "c", "d", "e"]}, "has the classes a, b"),
        ({"temperature": 0.0}, "temperature"),
        ({"bias": [0.0, 0.0, 0.0, 0.0, 1e9]}, "bias"),
        ({"name": "landscape"}, "network's own label head"),
        ({"mood": 3}, "mood: unknown key"),
    ],
)
def test_a_head_that_does_not_fit_is_refused_in_words(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    manifest = write_classifier(tmp_path, maps=True)
    head = write_swapping_head(tmp_path / "swap.yaml", manifest, **change)
    with pytest.raises(ModelError, match=said):
        read_label_head(head, NetworkManifest.load(manifest))


def test_maps_that_the_network_does_not_have_are_refused(tmp_path: Path) -> None:
    path = changed(write_classifier(tmp_path, maps=True), maps={"s9": 3})
    with pytest.raises(ModelError, match="map: expected 's9'"):
        Segmenter.open(path)
    path = changed(write_classifier(tmp_path, maps=True), maps={"mean": 4})
    with pytest.raises(ModelError, match=r"mean.*4"):
        Segmenter.open(path).scores_and_maps(_photo())


def test_a_head_s_label_errors_are_those_of_its_own_calibration(tmp_path: Path) -> None:
    names = ("sky", "grass", "shrub", "tree", "bare", "water", "built")
    confusion = np.full((7, 7), 0.05) + 0.65 * np.eye(7)
    confusion[2] = [0.0, 0.1, 0.6, 0.3, 0.0, 0.0, 0.0]
    calibration = {"classes": list(names), "confusion": confusion.tolist(), "measured_on": "two photos"}
    manifest = write_classifier(tmp_path, maps=True)
    write_swapping_head(tmp_path / "swap.yaml", manifest, calibration=calibration)
    errors = known_errors(str(manifest), "swap", tmp_path)
    shrub = LifeForm.SHRUB - 1
    np.testing.assert_allclose(errors.shares[shrub, [LifeForm.GRASS - 1, shrub, LifeForm.TREE - 1]], [0.1, 0.6, 0.3])
    assert errors.source == "label head swap, on two photos"
    assert not known_errors(str(manifest)).measured


def test_a_head_is_that_of_the_network_that_it_was_taught_on(tmp_path: Path) -> None:
    photo = np.random.default_rng(3).integers(0, 255, (72, 128, 3), np.uint8)
    by_default, of_it = (Segmenter.open(name, head="near") for name in ("landscape_v5", "landscape_lite0"))
    assert by_default.described == of_it.described
    np.testing.assert_array_equal(by_default.segment(photo).labels, of_it.segment(photo).labels)
    assert Segmenter.open("landscape_v5").manifest.name != by_default.manifest.name
    errors = [known_errors(name, "near") for name in ("landscape_v5", "landscape_lite0")]
    np.testing.assert_array_equal(errors[0].shares, errors[1].shares)
