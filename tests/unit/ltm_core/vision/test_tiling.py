from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.networks import COLORS, write_classifier

from ltm_core.vision.labels import Label
from ltm_core.vision.second_scale import tile_corners
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
