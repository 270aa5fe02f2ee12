from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.networks import COLORS, MAPPING, changed, write_classifier, write_swapping_head

from ltm_core.fuel.label_errors import labels_digest
from ltm_core.vision.label_head import read_label_head
from ltm_core.vision.labels import Label
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.second_scale import with_second_network
from ltm_core.vision.segmenter import Segmenter

SWAPPED = {**MAPPING, "red": "grass", "lime": "built", "olive": "built", "blue": "unlabelled"}


def test_the_mean_is_geometric_and_unknown_classes_repeat_the_first_answer() -> None:
    first, other = np.array([0.6, 0.3, 0.1]), np.array([0.2, 0.5, 0.0])
    found = with_second_network(*(np.float32(p)[:, None, None] * np.ones((1, *s), np.float32) for p, s in
                                  ((first, (4, 6)), (other, (2, 3)))), share=0.25)  # fmt: skip
    mean = first**0.75 * (other + 0.3 * first) ** 0.25
    np.testing.assert_allclose(found, np.broadcast_to((mean / mean.sum())[:, None, None], (3, 4, 6)), rtol=1e-5)


def pair(folder: Path, share: float, kind: str = "logits") -> NetworkManifest:
    """A classifier whose second network calls red what is lime and has no label for the sky."""
    (folder / "second").mkdir()
    second = changed(write_classifier(folder / "second", kind), mapping=SWAPPED)
    path = write_classifier(folder, gain=3.0, maps=True, second={"model": str(second), "share": share})
    return NetworkManifest.load(path)


@pytest.mark.parametrize(("share", "red"), [(0.05, Label.BUILT), (0.9, Label.GRASS)])
def test_the_surer_network_decides_by_its_share(tmp_path: Path, share: float, red: Label) -> None:
    image = np.empty((32, 48, 3), np.uint8)
    image[:16], image[16:] = COLORS["blue"], COLORS["red"]
    found = Segmenter(pair(tmp_path, share)).segment(image).labels
    assert (found[:15] == Label.SKY).all(), "the second network has no say here"
    assert (found[17:] == red).all()


def test_a_label_head_works_on_its_network_alone(tmp_path: Path) -> None:
    manifest = pair(tmp_path, 0.9)
    head = read_label_head(write_swapping_head(tmp_path / "swap.yaml", tmp_path / "colors.yaml"), manifest)[0]
    image = np.full((32, 48, 3), COLORS["lime"], np.uint8)
    assert (Segmenter(manifest, head=head).segment(image).labels == Label.BUILT).all()
    assert "second" not in Segmenter(manifest, head=head).described


def test_labels_are_named_by_both_networks(tmp_path: Path) -> None:
    manifest = pair(tmp_path, 0.5)
    assert manifest.second is not None
    names = {labels_digest(manifest), labels_digest(manifest.model_copy(update={"second": None}))}
    changed(Path(manifest.second.model), mapping=MAPPING)
    assert len(names | {labels_digest(manifest)}) == 3
