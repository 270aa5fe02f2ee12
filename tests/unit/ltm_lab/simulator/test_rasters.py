import numpy as np
from scenes.simulated_ground import GRID, cover

from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator.landcover import BARE, GRASS, SHRUB, TREE
from ltm_lab.simulator.rasters import (
    fuel_codes,
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
