"""True rasters of a site at one date, and the changes between two dates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator.canopy import canopy_height
from ltm_lab.simulator.landcover import BARE, BUILT, GRASS, SHRUB, TREE, WATER, LandCover
from ltm_lab.simulator.terrain_synthesis import HeightField
from ltm_lab.simulator.truth import fuel_truth
from ltm_lab.simulator.vegetation import Planting

SURFACE_CELL, FUEL_CELL = 1.0, 30.0  # m
TERRAIN_CHANGED, CANOPY_CHANGED, CLASS_CHANGED = 1, 2, 4  # bits of change rasters
_TERRAIN_STEP, _CANOPY_STEP = 0.1, 0.5  # m, the least that counts as change
UNKNOWN = 255
_STRIP = 256  # rows of the 1 m rasters sampled at once


@dataclass(frozen=True)
class SiteRasters:
    """Truth of one date. 1 m: `bare_earth`, `canopy` (height of plants over it), `classes` (ids), on `fine`.

    30 m: `life_form` (majority class id) and `fuel_code` (Scott and Burgan's number), 255 unknown, on `coarse`. Both
    geometries are in the CRS.
    """

    bare_earth: Float32Array
    canopy: Float32Array
    classes: UInt8Array
    fine: GridGeometry
    life_form: UInt8Array
    fuel_code: UInt8Array
    coarse: GridGeometry

    @property
    def surface(self) -> Float32Array:
        """Bare earth plus canopy, metres."""
        return self.bare_earth + self.canopy


def site_rasters(
    ground: HeightField, cover: LandCover, planting: Planting, origin: tuple[float, float], crs: str
) -> SiteRasters:
    """The truth of a site; `origin` is the CRS position of map (0, 0)."""
    x_min, y_min, x_max, y_max = ground.geometry.bounds
    shape = round((x_max - x_min) / SURFACE_CELL), round((y_max - y_min) / SURFACE_CELL)
    fine = GridGeometry(x_min, y_max, SURFACE_CELL, *shape)
    bare_earth, classes = np.empty(fine.shape, np.float32), np.empty(fine.shape, np.uint8)
    xs, _ = fine.to_map(0, np.arange(fine.width))
    for first in range(0, fine.height, _STRIP):
        rows = np.arange(first, min(first + _STRIP, fine.height))
        x, y = np.meshgrid(xs, fine.to_map(rows, 0)[1])
        bare_earth[rows], classes[rows] = ground.at(x, y), cover.at(x, y)
    canopy = canopy_height(planting.everywhere(), ground, fine)
    x0, y0 = origin
    coarse = GridGeometry.snapped((x_min + x0, y_min + y0, x_max + x0, y_max + y0), FUEL_CELL, 15.0, crs)
    life_form = fuel_truth(cover, coarse, origin)
    return SiteRasters(
        bare_earth,
        canopy,
        classes,
        fine.translated(x0, y0, crs),
        life_form,
        fuel_codes(life_form, cover, coarse, origin),
        coarse,
    )


def fuel_codes(
    life_form: UInt8Array, cover: LandCover, geometry: GridGeometry, origin: tuple[float, float]
) -> UInt8Array:
    """The fuel model (Scott and Burgan 2005) of each 30 m cell, 255 where no life form is known.

    Grass GR1/GR2/GR4 by moisture, with a quarter or more of shrub GS1/GS2; shrub SH2 low, SH5 tall and dry, SH7 tall
    and dense; trees TL6 under oak, TL8 under conifer, TU5 over grown shrub; burnt ground, rock and road NB9, water
    NB8, built NB1.
    """
    shares, moisture, height, conifer = _means(cover, geometry, origin)
    code = np.full(geometry.shape, UNKNOWN, np.uint8)
    grass, shrub, tree = (life_form == c for c in (GRASS, SHRUB, TREE))
    code[grass] = np.where(moisture > 0.35, 104, np.where(moisture > -0.35, 102, 101))[grass]
    mixed = grass & (shares[SHRUB] >= 0.25)
    code[mixed] = np.where(moisture > 0, 122, 121)[mixed]
    code[shrub] = np.where(height < 0.55, 142, np.where(moisture > -0.1, 147, 145))[shrub]
    code[tree] = np.where(conifer >= 0.5, 188, 186)[tree]
    code[tree & (shares[SHRUB] >= 0.25)] = 165
    for class_id, number in ((BARE, 99), (WATER, 98), (BUILT, 91)):
        code[life_form == class_id] = number
    return code


def _means(
    cover: LandCover, geometry: GridGeometry, origin: tuple[float, float]
) -> tuple[dict[int, Float32Array], Float32Array, Float32Array, Float32Array]:
    fine = cover.geometry
    x, y = fine.to_map(*np.mgrid[0 : fine.height, 0 : fine.width])
    row, col = geometry.cell_of(x + origin[0], y + origin[1])
    inside = geometry.contains(row, col)
    index = (row * geometry.width + col)[inside]
    cells = geometry.width * geometry.height
    count = np.maximum(np.bincount(index, minlength=cells), 1)

    def mean(values: NDArray[np.generic]) -> Float32Array:
        total = np.bincount(index, weights=np.asarray(values, np.float64)[inside], minlength=cells)
        return (total / count).reshape(geometry.shape).astype(np.float32)

    shares = {c: mean(cover.classes == c) for c in (SHRUB, TREE)}
    return shares, mean(cover.moisture), mean(cover.stand.shrub_height), mean(cover.stand.conifer)


@dataclass(frozen=True)
class SiteChange:
    """What differs between two dates. `fine` 1 m: TERRAIN_CHANGED, CANOPY_CHANGED, CLASS_CHANGED bits; 30 m masks."""

    fine: UInt8Array
    life_form: BoolArray
    fuel_code: BoolArray


def site_change(before: SiteRasters, after: SiteRasters) -> SiteChange:
    """Where the ground moved by 0.1 m or more, plants by 0.5 m or more, and where class, life form or fuel differ."""
    bits = np.zeros(before.classes.shape, np.uint8)
    bits[np.abs(after.bare_earth - before.bare_earth) >= _TERRAIN_STEP] |= TERRAIN_CHANGED
    bits[np.abs(after.canopy - before.canopy) >= _CANOPY_STEP] |= CANOPY_CHANGED
    bits[after.classes != before.classes] |= CLASS_CHANGED
    return SiteChange(bits, after.life_form != before.life_form, after.fuel_code != before.fuel_code)
