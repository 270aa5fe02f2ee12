"""Terrain as a block: what is seen where, by surfaces whose picture is known."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.base.errors import ImageError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import SKY_COLOR, error_colors, error_legend
from ltm_core.raster.dem import Dem
from ltm_lab.evaluation.pictures.block import BlockView, Pin, block_picture

NORTHWARD = BlockView(azimuth_deg=0.0, tilt_deg=30.0, exaggeration=1.0)


def flat(height: int = 40, width: int = 60) -> Dem:
    return Dem(np.zeros((height, width), np.float32), GridGeometry(0.0, height * 10.0, 10.0, width, height))


def columns_of(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    return np.abs(picture.astype(int) - color).max(axis=2) < 3


def test_a_plain_keeps_its_proportions() -> None:
    dem = flat()
    colors = np.zeros((40, 60, 3), np.uint8)
    colors[:20], colors[20:] = (200, 0, 0), (0, 0, 200)  # north red, south blue
    picture = block_picture(dem, colors, NORTHWARD, width=600)
    red, blue = columns_of(picture, (200, 0, 0)), columns_of(picture, (0, 0, 200))
    middle = picture.shape[1] // 2
    assert np.flatnonzero(red[:, middle]).max() < np.flatnonzero(blue[:, middle]).min()  # north is above
    deep = red[:, middle].sum() + blue[:, middle].sum()
    wide = blue[np.flatnonzero(blue[:, middle])[5]].sum()
    # 390 m deep, seen at 30 degrees: half; 590 m wide.
    assert deep / wide == pytest.approx(390 * np.sin(np.deg2rad(30)) / 590, rel=0.04)


def test_a_ridge_hides_what_is_behind() -> None:
    heights = np.zeros((60, 50), np.float32)
    heights[30] = 150.0
    dem = Dem(heights, GridGeometry(0.0, 600.0, 10.0, 50, 60))
    colors = np.full((60, 50, 3), (0, 160, 0), np.uint8)
    colors[22:29] = (200, 0, 0)  # 20 to 80 m behind the ridge, whose shadow at 30 degrees is 260 m long
    hidden = block_picture(dem, colors, NORTHWARD, width=500)
    assert not columns_of(hidden, (200, 0, 0)).any()
    from_above = block_picture(dem, colors, BlockView(0.0, 84.0, 1.0), width=500)
    assert columns_of(from_above, (200, 0, 0)).any()


def test_pins_and_refusals() -> None:
    dem = flat()
    colors = np.full((40, 60, 3), 120, np.uint8)
    plain = block_picture(dem, colors, NORTHWARD, width=600)
    pinned = block_picture(dem, colors, NORTHWARD, [Pin("mast", (300.0, 200.0, 0.0))], width=600)
    changed = np.argwhere((plain != pinned).any(axis=2))
    assert abs(changed[:, 1].min() - 300) < 10
    with pytest.raises(ImageError, match="do not fit a DEM"):
        block_picture(dem, colors[:-1], NORTHWARD)
    with pytest.raises(ImageError, match="5 to 85 degrees"):
        BlockView(tilt_deg=0)


def test_error_colors() -> None:
    truth = np.array([[10.0, 10.0, np.inf, np.inf, 10.0]], np.float32)
    estimate = np.array([[10.1, 310.0, np.inf, 50.0, np.nan]], np.float32)
    small, large, sky, missed, unknown = error_colors(estimate, truth)[0].astype(int)
    assert small.sum() < 60 < 400 < large.sum()
    assert tuple(sky) == SKY_COLOR
    assert tuple(missed) == tuple(unknown) == (190, 192, 196)
    assert error_legend(400).shape[1] == 400
