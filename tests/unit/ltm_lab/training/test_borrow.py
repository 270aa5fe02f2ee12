from __future__ import annotations

import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.vision.labels import Label
from ltm_lab.training.borrow import with_ground

SIZE = (64, 96)


def _scene(ground: int, colour: tuple[int, int, int], skyline: int = 24) -> tuple[UInt8Array, UInt8Array]:
    """Blue sky, brighter to the right, above ground of one class and colour, darker downwards."""
    photo = np.empty((*SIZE, 3), np.float32)
    photo[:] = np.array([90, 140, 200]) + np.linspace(0, 40, SIZE[1])[None, :, None]
    photo[skyline:] = np.array(colour) - np.linspace(0, 25, SIZE[0] - skyline)[:, None, None]
    labels = np.full(SIZE, ground, np.uint8)
    labels[:skyline] = Label.SKY
    return photo.astype(np.uint8), labels


def test_lent_ground_brings_its_labels_and_comes_towards_the_photos_colours() -> None:
    photo, labels = _scene(Label.TREE, (60, 90, 50))
    sand, other = _scene(Label.SHRUB, (210, 190, 150), skyline=30)
    host, donor = (photo, labels, np.ones(SIZE, np.float32)), (sand, other, np.ones(SIZE, np.float32))
    for seed in range(6):
        mixed, found, inverse = with_ground(host, donor, np.random.default_rng(seed))
        patch = found == Label.SHRUB
        assert 0.01 < patch.mean() < 0.6
        assert not patch[:30].any()  # the donor's sky is not lent
        np.testing.assert_array_equal(found[~patch], labels[~patch])
        np.testing.assert_array_equal(np.isnan(inverse), patch)
        own, before, after = photo[30:].mean(axis=(0, 1)), sand[patch].mean(axis=0), mixed[patch].mean(axis=0)
        assert np.abs(after - own).sum() < 0.8 * np.abs(before - own).sum()
