import numpy as np

from ltm_core.fuel.codes import FuelClimate, FuelSystem
from ltm_core.fuel.decision import layers_of_classes
from ltm_core.fuel.export.export_grid import make_landscape
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem

FRAME = SiteFrame("EPSG:32611", 346_000.0, 3_783_000.0)
GRID = GridGeometry(345_975.0, 3_783_195.0, 30.0, 9, 7, "EPSG:32611")
TERRAIN = GridGeometry(0.0, 180.0, 10.0, 22, 15)
"""In the map frame: it covers columns 1 to 7 and half of row 0; of column 0 and rows 5 and 6 little or nothing."""


def made() -> Landscape:
    rows, cols = np.indices(TERRAIN.shape)
    heights = (500 + 2.0 * cols - 4.0 * rows).astype(np.float32)
    prior = FuelPrior(np.full(GRID.shape, 102, np.int16), GRID)
    climate = FuelClimate.named("dry")
    layers = layers_of_classes(np.full(GRID.shape, 255, np.uint8), prior, climate)
    return make_landscape(layers, prior, Dem(heights, TERRAIN), FRAME, GRID, climate, FuelSystem.FBFM40)


def complete(landscape: Landscape) -> bool:
    known = landscape.band("fuel") != NODATA
    return all(((landscape.band(name) != NODATA) == known).all() for name in ("elevation", "slope", "aspect"))


def test_a_cell_that_the_terrain_covers_in_part_has_its_height() -> None:
    landscape = made()
    assert complete(landscape)
    known = landscape.band("fuel") != NODATA
    assert known[1, 1:8].all()
    assert known[0, 1:7].all()  # half of them
    # The plane rises 0.2 to the east and falls 0.4 to the south.
    assert set(np.unique(landscape.band("slope")[2:4, 2:6]).tolist()) == {24}
    assert (landscape.band("slope")[0, 2:6] > 10).all()
