"""How far crests stand over the DEM, by label and range."""

from __future__ import annotations

import math

import numpy as np

from ltm_core.pose_estimation.skyline.picture_pose_config import BARE_EARTH, CoverHeights, CrestCover
from ltm_core.vision.labels import UNLABELLED, Label

COVER = CrestCover(
    near=CoverHeights(tree=(8.0, 5.0), shrub=(1.0, 0.5), grass=(0.2, 0.1), bare=(0.0, 0.3), other=(3.0, 6.0)),
    far=CoverHeights(tree=(2.0, 3.0), shrub=(2.0, 1.5), grass=(0.4, 0.3), bare=(0.1, 0.5), other=(3.0, 4.0)),
)


def test_heights_go_from_near_to_far_by_the_logarithm_of_the_range() -> None:
    labels = np.array([Label.TREE, Label.TREE, Label.TREE, Label.SHRUB, Label.WATER, UNLABELLED], np.uint8)
    ranges = np.array([40.0, math.sqrt(250 * 1500), 9000.0, math.sqrt(250 * 1500), 250.0, 1500.0])
    height, sigma = COVER.at(labels, ranges)
    np.testing.assert_allclose(height, [8.0, 5.0, 2.0, 1.5, 0.0, 3.0])
    np.testing.assert_allclose(sigma, [5.0, 4.0, 3.0, 1.0, 0.3, 4.0])


def test_the_compiled_search_gets_both_ends() -> None:
    labels = np.array([Label.GRASS, Label.BARE], np.uint8)
    np.testing.assert_allclose(COVER.of(labels), [[0.2, 0.1, 0.4, 0.3], [0.0, 0.3, 0.1, 0.5]])


def test_plants_stand_the_higher_the_larger_they_are() -> None:
    labels = np.array([Label.BARE, Label.GRASS, Label.SHRUB, Label.TREE], np.uint8)
    for metres in (100.0, 700.0, 5000.0):
        height, sigma = BARE_EARTH.at(labels, np.full(4, metres))
        assert (np.diff(height) > 0).all()
        assert sigma[3] > sigma[2] > sigma[1]
