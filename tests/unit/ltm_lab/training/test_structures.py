import numpy as np
import pytest

from ltm_core.label_heads.labelled_frames import UNKNOWN
from ltm_core.vision.labels import Label
from ltm_lab.training.structures import with_structures


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
