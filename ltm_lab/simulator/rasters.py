"""Rasters of a site: the truth at one date, the changes between two dates, and the DEMs that the system is given."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.canopy import canopy_height
from ltm_lab.simulator.ground_mesh import far_radii, far_surface
from ltm_lab.simulator.landcover import BARE, BUILT, GRASS, SHRUB, TREE, WATER, LandCover
from ltm_lab.simulator.scenario import OutdatedDemConfig
from ltm_lab.simulator.terrain_synthesis import HeightField, SyntheticTerrain, axes
from ltm_lab.simulator.vegetation import Planting

SURFACE_CELL, FUEL_CELL = 1.0, 30.0  # m
TERRAIN_CHANGED, CANOPY_CHANGED, CLASS_CHANGED = 1, 2, 4  # bits of change rasters
_TERRAIN_STEP, _CANOPY_STEP = 0.1, 0.5  # m, the least that counts as change
UNKNOWN = 255
_STRIP = 256  # rows of the 1 m rasters sampled at once
_QUANTUM = 1 / 16  # m; a binary fraction deflates well
_REACH, _CELL = 42_000.0, 90.0  # m, of the regional DEM


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


def outdated_dem(site: HeightField, config: OutdatedDemConfig, seed: int) -> tuple[Float32Array, GridGeometry]:
    """Return an older, coarser survey of the true ground, with the errors of `config`: elevation (H, W) float32 and its
    geometry in the map frame.

    Each cell is the mean of the ground under it, as a survey grids its returns; the error's wavelengths are 60 m to
    900 m.
    """
    g = site.geometry
    resolution = config.resolution
    size = int(g.width * g.resolution // resolution)
    geometry = GridGeometry(g.x_min, g.y_min + size * resolution, resolution, size, size)
    n = 3 if resolution > g.resolution else 1  # a cell finer than the ground has nothing to average
    fine = GridGeometry(geometry.x_min, geometry.y_max, resolution / n, size * n, size * n)
    xs, ys = axes(fine)
    east, north = config.shift
    rows = (g.y_max - (ys - north)) / g.resolution - 0.5
    cols = ((xs - east) - g.x_min) / g.resolution - 0.5
    z = ndimage.map_coordinates(
        site.elevation, np.meshgrid(rows, cols, indexing="ij"), np.float64, order=1, mode="nearest"
    )
    mean = z.reshape(size, n, size, n).mean(axis=(1, 3))
    xs, ys = axes(geometry)
    error = noise_fields.fractal(xs, ys, 900.0, seed + 601, octaves=4, gain=0.8).astype(np.float64)
    error -= error.mean()
    spread = float(error.std())
    if config.sigma > 0 and spread > 0:
        mean += error * config.sigma / spread
    mean += config.bias
    return (np.rint(mean / _QUANTUM) * _QUANTUM).astype(np.float32), geometry


def regional_dem(terrain: SyntheticTerrain, seed: int) -> tuple[Float32Array, GridGeometry]:
    """Return a coarse DEM of the site's surroundings and the mountains on the horizon: elevation (H, W) float32, whole
    metres as in global models, of 90 m cells out to 42 km from the site's middle, and its geometry in the map frame."""
    wide = terrain.surroundings
    g = wide.geometry
    middle = np.array([(g.x_min + g.x_max) / 2, (g.y_min + g.y_max) / 2])
    size = 2 * round(_REACH / _CELL)
    geometry = GridGeometry(middle[0] - size / 2 * _CELL, middle[1] + size / 2 * _CELL, _CELL, size, size)
    columns, rows = np.meshgrid(np.arange(size), np.arange(size))
    east, north = geometry.to_map(rows, columns)
    ring, turn = _polar(east - middle[0], north - middle[1], (g.x_max - g.x_min) / 2)
    _, _, z = far_surface(wide, seed, middle, 0.0)
    elevation = ndimage.map_coordinates(z, [ring, turn], np.float64, order=1, mode="nearest")
    near = (east > g.x_min) & (east < g.x_max) & (north > g.y_min) & (north < g.y_max)
    elevation[near] = wide.at(east[near], north[near])
    return np.asarray(np.rint(elevation), np.float32), geometry


def _polar(x: Float64Array, y: Float64Array, half: float) -> tuple[Float64Array, Float64Array]:
    """Fractional row and column in `far_surface` of points about its middle."""
    angle = np.arctan2(y, x) % (2 * np.pi)
    reach = np.hypot(x, y)
    square = 1 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
    # From half to 3 half: reach = r ((1 - blend) square + blend) with blend = (r - half) / (2 half).
    bent = np.maximum((square - 1) / (2 * half), 1e-12)
    linear = square + bent * half
    radius = (linear - np.sqrt(np.maximum(linear**2 - 4 * bent * reach, 0.0))) / (2 * bent)
    radius = np.where(reach >= 3 * half, reach, np.where(radius < half, reach / square, radius))
    radii = far_radii(half)
    return np.interp(radius, radii, np.arange(len(radii))), angle / (2 * np.pi) * 720


def fuel_truth(cover: LandCover, geometry: GridGeometry, offset: tuple[float, float]) -> UInt8Array:
    """Majority class of each cell of `geometry` (CRS coordinates; `offset` is the CRS position of map (0, 0)); ties
    go to the lower id."""
    fine = cover.geometry
    rows, cols = np.mgrid[0 : fine.height, 0 : fine.width]
    x, y = fine.to_map(rows, cols)
    row, col = geometry.cell_of(x + offset[0], y + offset[1])
    inside = geometry.contains(row, col)
    counts = np.zeros((geometry.height * geometry.width, 8), np.int64)
    np.add.at(counts, ((row * geometry.width + col)[inside], np.minimum(cover.classes[inside], 7)), 1)
    out = counts.argmax(axis=1).astype(np.uint8)
    out[counts.sum(axis=1) == 0] = 255
    return np.asarray(out.reshape(geometry.shape), np.uint8)
