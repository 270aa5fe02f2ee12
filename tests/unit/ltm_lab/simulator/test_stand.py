import numpy as np
import pytest
from scenes.simulated_ground import BOX, GRID, after, inside_box, terrain

from ltm_lab.simulator.changes import (
    Conversion,
    Landslide,
    MaskConfig,
)
from ltm_lab.simulator.landcover import GRASS, SHRUB, TREE
from ltm_lab.simulator.stand import changed_terrain, mask_weights


def test_shapes_of_masks() -> None:
    np.testing.assert_array_equal(mask_weights(BOX, GRID, 1), inside_box())
    corners = [(100.0, 60.0), (240.0, 60.0), (240.0, 180.0), (100.0, 180.0)]
    np.testing.assert_array_equal(mask_weights(MaskConfig(polygon=corners, ragged=0), GRID, 1), inside_box())
    round_one = mask_weights(MaskConfig(circle=(200.0, 150.0, 60.0), ragged=0), GRID, 1)
    assert round_one.sum() * 16 == pytest.approx(np.pi * 60**2, rel=0.02)
    ragged = mask_weights(MaskConfig(circle=(200.0, 150.0, 60.0), ragged=12), GRID, 1)
    assert ragged.sum() == pytest.approx(round_one.sum(), rel=0.3)
    assert np.any(ragged != round_one)


def test_conversion_takes_the_classes_named() -> None:
    stripes = np.where(np.arange(GRID.width) % 2, GRASS, TREE).astype(np.uint8)[None, :]
    change = Conversion(kind="conversion", to="shrub", of=["grass"], mask=BOX, age=4.0)
    out = after(change, 0.0, stripes)
    assert np.all(out.classes[:, ::2] == TREE)
    np.testing.assert_array_equal(out.classes[:, 1::2] == SHRUB, inside_box()[:, 1::2])
    young = out.stand.shrub_height[:, 1::2][inside_box()[:, 1::2]]
    assert np.all(young < 0.5)


def test_earth_moves_inside_the_mask_and_stays() -> None:
    ground = terrain()
    mask = MaskConfig(box=(60.0, 80.0, 220.0, 200.0), ragged=0.0)
    slide = Landslide(kind="landslide", depth=6.0, deposit=1.0, mask=mask, years=1.0)
    assert changed_terrain(ground, [slide], 0.5, 3) is ground
    moved = changed_terrain(ground, [slide], 1.0, 3)
    dz = moved.site.elevation - ground.site.elevation
    x, _ = np.meshgrid(*moved.site.axes())
    assert dz.min() == pytest.approx(-6.0, abs=0.3)
    assert dz[x < 120].max() > 2.0
    assert dz[:, x[0] > 190].max() < 0.05, "it slides downhill"
    assert abs(dz.sum()) < 0.1 * np.abs(dz).sum(), "what leaves the scar lies in the toe"
    wide_dz = moved.surroundings.at(180.0, 140.0) - ground.surroundings.at(180.0, 140.0)
    assert wide_dz == pytest.approx(float(moved.site.at(180.0, 140.0) - ground.site.at(180.0, 140.0)), abs=0.8)
