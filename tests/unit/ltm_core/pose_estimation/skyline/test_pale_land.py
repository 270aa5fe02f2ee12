from __future__ import annotations

import cv2
import numpy as np
import pytest

from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.pose_estimation.skyline.image_edges import pale_edges

HEIGHT, WIDTH = 210, 640
COLUMNS = np.arange(1, WIDTH, 3)
CREST: Float64Array = 120.0 + 14 * np.sin(np.arange(WIDTH) / 90.0)
"""The rows where near land begins,"""
RANGE: Float64Array = CREST - 6.5 + 3 * np.sin(np.arange(WIDTH) / 17.0)
"""and where a far range does, 3.5 to 9.5 above."""
NEAR, PALE, WHITE = (70.0, 80.0, 50.0), (186.0, 203.0, 216.0), (250.0, 250.0, 250.0)


def photo(*layers: tuple[Float64Array, tuple[float, float, float]], noise: float = 1.0) -> UInt8Array:
    """Sky, paler towards the horizon, before which each of some layers begins at rows (W,), from the farthest on."""
    rows = np.mgrid[0:HEIGHT, 0:WIDTH][0][..., None]
    image = np.array([170.0, 200.0, 235.0]) + np.array([0.18, 0.10, 0.02]) * rows
    for begin, colour in layers:
        covered = np.clip(rows - begin[None, :, None] + 0.5, 0, 1)
        image = covered * np.array(colour) + (1 - covered) * image
    image = image + noise * np.random.default_rng(3).normal(size=image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def edges(image: UInt8Array, crest: Float64Array = CREST) -> tuple[Float64Array, Float64Array]:
    """Rows found in COLUMNS, and those of the crest there."""
    v = crest[COLUMNS]
    return pale_edges(image, COLUMNS, v), v


def test_a_far_range_above_a_nearer_crest_is_found_to_a_pixel() -> None:
    found, v = edges(photo((RANGE, PALE), (CREST, NEAR)))
    assert (found < v).mean() > 0.8
    away = (found - RANGE[COLUMNS])[found < v]
    assert np.percentile(np.abs(away), 95) < 1.0
    assert abs(np.median(away)) < 0.5


@pytest.mark.parametrize("noise", [0.0, 1.0, 3.0])
def test_without_one_the_crest_stays(noise: float) -> None:
    found, v = edges(photo((CREST, NEAR), noise=noise))
    np.testing.assert_array_equal(found, v)


@pytest.mark.parametrize("steepness", [0.6, 1.5, 4.0])
def test_a_blurred_slanted_edge_is_no_range(steepness: float) -> None:
    slope = np.clip(60.0 + steepness * np.abs(np.arange(WIDTH) - 333.0), 0, 170)
    blurred = cv2.GaussianBlur(photo((slope, NEAR), noise=0.5), (0, 0), 1.2)
    found, v = edges(np.asarray(blurred, np.uint8), slope)
    assert (found < v).mean() < 0.02


def test_a_cloud_that_ends_above_the_crest_is_none() -> None:
    """Between them is the sky again."""
    image = photo((RANGE - 9.0, WHITE), (CREST, NEAR))
    clear = photo((CREST, NEAR))
    rows = np.mgrid[0:HEIGHT, 0:WIDTH][0]
    image = np.where((rows < RANGE - 3.0)[..., None], image, clear)
    found, v = edges(image)
    np.testing.assert_array_equal(found, v)


def test_single_columns_are_not_believed() -> None:
    """A bird, a pole, a thin cloud."""
    spots = np.where(np.arange(WIDTH) % 40 < 4, RANGE, CREST)
    found, v = edges(photo((spots, PALE), (CREST, NEAR)))
    np.testing.assert_array_equal(found, v)
