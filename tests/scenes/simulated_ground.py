"""Land cover and ground of a small simulated site, and what a change makes of them."""

import numpy as np

from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator.changes import Change, MaskConfig
from ltm_lab.simulator.landcover import SHRUB, LandCover, Stand
from ltm_lab.simulator.stand import stand_at
from ltm_lab.simulator.terrain_synthesis import HeightField, SyntheticTerrain

GRID = GridGeometry(0.0, 300.0, 4.0, 100, 75)  # 400 m by 300 m
BOX = MaskConfig(box=(100.0, 60.0, 240.0, 180.0), ragged=0.0)


def cover(classes: UInt8Array | int = SHRUB) -> LandCover:
    zeros = np.zeros(GRID.shape, np.float32)
    values = np.broadcast_to(np.asarray(classes, np.uint8), GRID.shape).copy()
    return LandCover(values, zeros.astype(bool), zeros, zeros, GRID, Stand.undisturbed(GRID.shape))


def inside_box() -> BoolArray:
    x, y = GRID.to_map(*np.mgrid[0 : GRID.height, 0 : GRID.width])
    return np.asarray((x >= 100) & (x <= 240) & (y >= 60) & (y <= 180), np.bool_)


def after(change: Change, years: float, classes: UInt8Array | int = SHRUB) -> LandCover:
    return stand_at(cover(classes), [change], years, 25.0, False, 3)


def terrain() -> SyntheticTerrain:
    fields = []
    for g in (GridGeometry(0.0, 300.0, 2.0, 150, 150), GridGeometry(-104.0, 404.0, 8.0, 64, 64)):
        x, y = np.meshgrid(*HeightField(np.empty((0, 0), np.float32), g).axes())
        fields.append(HeightField((200 + 0.3 * x + 0.05 * np.abs(y - 150)).astype(np.float32), g))
    return SyntheticTerrain(fields[0], fields[1], np.zeros((64, 64), np.float32))
