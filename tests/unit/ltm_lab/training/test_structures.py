"""Tests of masts, huts and dishes that are drawn into training windows, and of rock that is put into shade."""

import numpy as np
import pytest

from ltm_core.label_heads.labelled_frames import UNKNOWN
from ltm_core.vision.labels import Label
from ltm_lab.training.augment import augmented
from ltm_lab.training.config import AugmentConfig
from ltm_lab.training.structures import with_structures
from ltm_lab.training.training_frames import TrainingFrame

NOTHING = AugmentConfig(**dict.fromkeys(AugmentConfig.model_fields, 0.0))


def scene() -> tuple[np.ndarray, np.ndarray]:
    """Sky over trees, bare ground at the right: photo (72, 104, 3), labels."""
    labels = np.full((72, 104), Label.SKY, np.uint8)
    labels[30:] = Label.TREE
    labels[40:, 60:] = Label.BARE
    photo = np.array([[0.6, 0.7, 0.9], [0, 0, 0], [0, 0, 0], [0.1, 0.25, 0.08], [0.6, 0.5, 0.4]], np.float32)[labels]
    return photo, labels


@pytest.mark.parametrize("seed", range(12))
def test_what_is_drawn_is_built_and_the_rest_stays(seed: int) -> None:
    photo, labels = scene()
    drawn, changed = with_structures(photo, labels, np.random.default_rng(seed))
    built, edge = changed == Label.BUILT, changed == UNKNOWN
    rest = ~built & ~edge
    np.testing.assert_array_equal(changed[rest], labels[rest])
    assert np.abs(drawn - photo)[rest].max() < 0.1  # less than a tenth of a pixel is covered
    assert drawn.dtype == np.float32
    assert drawn.min() >= 0
    assert drawn.max() <= 1
    again, same = with_structures(photo, labels, np.random.default_rng(seed))
    np.testing.assert_array_equal(drawn, again)
    np.testing.assert_array_equal(changed, same)


def test_shade_darkens_bare_ground_alone_and_takes_its_colour(tmp_path) -> None:  # noqa: ANN001
    photo, labels = scene()
    frame = TrainingFrame(np.round(photo * 255).astype(np.uint8), labels, tmp_path / "a.png")
    shaded = 0
    for seed in range(8):
        changed, same, _ = augmented(
            frame, labels.shape, NOTHING.model_copy(update={"shade": 1.0}), np.random.default_rng(seed)
        )
        np.testing.assert_array_equal(same, labels)
        away = labels != Label.BARE
        away[36:44], away[:, 54:] = False, False  # the edge is soft
        np.testing.assert_array_equal(changed[away], frame.image[away])
        rock = changed[50:, 70:].reshape(-1, 3).astype(float)
        shaded += rock.mean() < 0.8 * frame.image[50:, 70:].mean()
    assert shaded >= 5
