from __future__ import annotations

import numpy as np
from scenes.simulated_ground import GRID, cover

from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator.landcover import BARE, GRASS, SHRUB, TREE
from ltm_lab.simulator.rasters import (
    CANOPY_CHANGED,
    CLASS_CHANGED,
    TERRAIN_CHANGED,
    SiteRasters,
    fuel_codes,
    site_change,
)
from ltm_lab.simulator.stand import stand_at


def test_fuel_codes_follow_cover_moisture_and_height() -> None:
    classes = np.full(GRID.shape, GRASS, np.uint8)
    classes[:, 25:50], classes[:, 50:75], classes[:, 75:] = SHRUB, TREE, BARE
    low = stand_at(cover(classes), [], 0.0, 25.0, False, 3)
    tall = stand_at(cover(classes), [], 0.0, 1.0, False, 3)
    cells = GridGeometry(0.0, 300.0, 100.0, 4, 3)
    forms = np.tile(np.array([GRASS, SHRUB, TREE, BARE], np.uint8), (3, 1))
    codes = fuel_codes(forms, low, cells, (0.0, 0.0))
    assert codes.tolist() == [[102, 147, 186, 99]] * 3
    assert fuel_codes(forms, tall, cells, (0.0, 0.0))[0].tolist() == [102, 142, 186, 99], "young shrub is low"


def test_change_bits() -> None:
    g = GridGeometry(0.0, 3.0, 1.0, 4, 3)
    coarse = GridGeometry(0.0, 30.0, 30.0, 1, 1)

    def rasters(ground: float, plants: float, class_id: int, code: int) -> SiteRasters:
        flat = np.full(g.shape, 100.0, np.float32)
        bare, canopy, classes = flat.copy(), 0 * flat, np.full(g.shape, GRASS, np.uint8)
        bare[0, 1] += ground
        canopy[1, 2] += plants
        classes[2, 3] = class_id
        form = np.full((1, 1), GRASS, np.uint8)
        return SiteRasters(bare, canopy, classes, g, form, np.full((1, 1), code, np.uint8), coarse)

    change = site_change(rasters(0, 0, GRASS, 102), rasters(0.2, 0.6, SHRUB, 122))
    want = np.zeros(g.shape, np.uint8)
    want[0, 1], want[1, 2], want[2, 3] = TERRAIN_CHANGED, CANOPY_CHANGED, CLASS_CHANGED
    np.testing.assert_array_equal(change.fine, want)
    assert not change.life_form[0, 0]
    assert change.fuel_code[0, 0]
    small = site_change(rasters(0, 0, GRASS, 102), rasters(0.05, 0.4, GRASS, 102))
    assert not small.fine.any()
