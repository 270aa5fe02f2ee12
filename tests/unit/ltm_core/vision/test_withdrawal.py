from pathlib import Path

import numpy as np
import pytest
from scenes.networks import COLORS, changed, write_classifier

from ltm_core.base.types import UInt8Array
from ltm_core.vision.label_rules import withdraw
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.manifest import Withdrawal
from ltm_core.vision.segmenter import Segmenter


def _answer() -> tuple[UInt8Array, UInt8Array, UInt8Array]:
    """Flat at the left, stripes of a pixel, black and white, at the right; tree above, shrub below."""
    image = np.full((300, 640, 3), 120, np.uint8)
    image[:, 320::2], image[:, 321::2] = 0, 200
    labels = np.full((300, 640), Label.TREE, np.uint8)
    labels[140:] = Label.SHRUB
    confidence = np.tile(np.linspace(0, 255, 300).astype(np.uint8)[:, None], (1, 640))
    return image, labels, confidence


def test_flat_tree_is_withdrawn_and_nothing_else() -> None:
    image, labels, confidence = _answer()
    before = labels.copy()
    withdraw(image, labels, confidence, Withdrawal(tree_contrast=11))
    assert (labels[:140, :300] == UNLABELLED).all()
    assert (confidence[:140, :300] == 0).all()
    np.testing.assert_array_equal(labels[:140, 330:], before[:140, 330:])
    np.testing.assert_array_equal(labels[140:], before[140:])


def test_labels_of_low_probability_are_withdrawn() -> None:
    image, labels, confidence = _answer()
    before = confidence.copy()
    withdraw(image, labels, confidence, Withdrawal(confidence=0.4))
    np.testing.assert_array_equal(labels == UNLABELLED, before < 102)
    assert (confidence[before >= 102] == before[before >= 102]).all()


@pytest.mark.parametrize("share", [0.0, 0.9])
def test_a_manifest_states_what_is_withdrawn(tmp_path: Path, share: float) -> None:
    path = changed(write_classifier(tmp_path, gain=1.0), output={"withdraw": {"confidence": share}})
    photo = np.full((40, 70, 3), COLORS["lime"], np.uint8)
    found = Segmenter.open(path).segment(photo)
    assert (found.labels == (UNLABELLED if share else Label.GRASS)).all()
