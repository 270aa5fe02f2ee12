from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes.networks import COLORS, write_classifier

from ltm_core.vision.labels import Label
from ltm_core.vision.second_scale import tile_corners, with_distant_tiles
from ltm_core.vision.segmenter import Segmenter

SIZE = (36, 60)


@pytest.mark.parametrize("zoom", [1.5, 2.0, 3.0])
def test_tiles_cover_the_skyline(zoom: float) -> None:
    rows, cols = SIZE
    line = np.linspace(4, 31, cols).astype(np.float32)
    line[:7] = np.nan
    corners = tile_corners(line, SIZE, zoom)
    for col in range(7, cols):
        seen = [top <= line[col] <= top + rows / zoom for top, left in corners if left <= col <= left + cols / zoom]
        assert any(seen), col
    assert all(0 <= top <= rows - rows / zoom and 0 <= left <= cols - cols / zoom for top, left in corners)
    assert len(corners) < 4 * zoom**2


def test_tiles_that_agree_change_nothing() -> None:
    """A `look` that answers with the truth of its own part gives back the truth, enlarged."""
    truth = np.zeros((2, 144, 240), np.float32)
    rows = np.arange(144)[:, None] < np.linspace(40, 90, 240)[None]
    truth[0], truth[1] = rows, ~rows
    image = np.repeat((truth[0] * 255).astype(np.uint8)[..., None], 3, axis=2)

    def look(part: np.ndarray) -> np.ndarray:
        sky = cv2.resize(part[..., 0], SIZE[::-1], interpolation=cv2.INTER_AREA).astype(np.float32) / 255.0
        return np.stack([sky, 1.0 - sky])

    coarse = look(image)
    fine = with_distant_tiles(image, coarse, 0, 2.0, look)
    assert fine.shape == (2, 72, 120)
    expected = cv2.resize(truth[0], (120, 72), interpolation=cv2.INTER_AREA)
    enlarged = cv2.resize(coarse[0], (120, 72), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(fine.sum(axis=0), 1.0, atol=1e-5)
    assert np.abs(fine[0] - expected).mean() < 0.75 * np.abs(enlarged - expected).mean()


def test_zoom_finds_what_the_whole_photo_is_too_coarse_for(tmp_path: Path) -> None:
    """Red posts on the skyline, thinner than a pixel of the network's, are lost at once and found again."""
    segmenter = Segmenter.open(write_classifier(tmp_path, stride=1))
    photo = np.empty((256, 384, 3), np.uint8)
    photo[:] = COLORS["lime"]
    photo[:110] = COLORS["blue"]
    for col in range(24, 384, 48):
        photo[114:140, col : col + 4] = COLORS["red"]
    truth = np.all(photo == COLORS["red"], axis=-1)
    once, twice = segmenter.segment(photo), segmenter.segment(photo, zoom=3.0)
    assert np.mean(once.labels[truth] == Label.BUILT) < 0.1
    assert np.mean(twice.labels[truth] == Label.BUILT) > 0.3
    assert np.mean(twice.labels[:100] == Label.SKY) > 0.99
