"""Land cover of a synthetic site: the class map that says where which vegetation stands, and its shares over cells."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int64Array, UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.scenario import VegetationConfig
from ltm_lab.simulator.terrain_synthesis import HeightField, SyntheticTerrain
from ltm_lab.simulator.works import YARD, Houses, hamlet, track

SKY, GRASS, SHRUB, TREE, BARE, WATER, BUILT = 0, 1, 2, 3, 4, 5, 6  # ids of config/labels.yaml
UNLABELLED = 255


@dataclass(frozen=True)
class Stand:
    """The state of the plants, cell by cell of the land cover.

    `shrub_height`, `tree_height`: relative to mature ones. `density`: plants relative to closed cover. `conifer`:
    which trees stand where trees stand. `char` 0..1: black ground. `scorch` 0..1: tree crowns killed by heat. `dead`:
    class id of what fire has left standing dead (SHRUB, TREE), else 0. `rock`: bare ground is of stone.
    `touched`: number of the last change here, 0 none.
    """

    shrub_height: Float32Array
    tree_height: Float32Array
    density: Float32Array
    conifer: BoolArray
    char: Float32Array
    scorch: Float32Array
    dead: UInt8Array
    rock: BoolArray
    touched: UInt8Array

    @staticmethod
    def undisturbed(shape: tuple[int, int], conifer: BoolArray | None = None, density: float = 1.0) -> "Stand":
        """Mature plants, no traces of fire, stone wherever the ground is bare."""
        zeros, ones = np.zeros(shape, np.float32), np.ones(shape, np.float32)
        if conifer is None:
            conifer = np.zeros(shape, bool)
        none, rock = np.zeros(shape, np.uint8), np.ones(shape, bool)
        return Stand(ones, ones, density * ones, conifer, zeros, zeros, none, rock, none)


@dataclass(frozen=True)
class LandCover:
    """Class ids (H, W) uint8 on `geometry` (map frame), and what the placing of plants needs beside them.

    `road`: the cells of the track. `moisture`: about [-1, 1], ravines and shaded slopes high. `exposure`: [-1,
    1], 1 steep and facing south.
    """

    classes: UInt8Array
    road: BoolArray
    moisture: Float32Array
    exposure: Float32Array
    geometry: GridGeometry
    stand: Stand
    houses: Houses = field(default_factory=Houses.none)

    def at(self, x: ArrayLike, y: ArrayLike) -> UInt8Array:
        """Class ids at map points; the nearest cell's outside."""
        return np.asarray(self.classes[self._cell(x, y)], np.uint8)

    def on_road(self, x: ArrayLike, y: ArrayLike, side: float) -> BoolArray:
        """Return whether a corner or the centre of the square of `side` about each map point is on the track."""
        h = side / 2
        hit = np.zeros(np.shape(x), bool)
        for dx, dy in ((0, 0), (-h, -h), (h, -h), (-h, h), (h, h)):
            hit |= self.road[self._cell(np.add(x, dx), np.add(y, dy))]
        return hit

    def sample(self, raster: NDArray[Any], x: ArrayLike, y: ArrayLike) -> Float32Array:
        """A raster of this geometry at map points, nearest cell."""
        return np.asarray(raster[self._cell(x, y)], np.float32)

    def _cell(self, x: ArrayLike, y: ArrayLike) -> tuple[Int64Array, Int64Array]:
        """Return the rows and columns of the cells nearest to map points."""
        row, col = self.geometry.cell_of(x, y)
        return np.clip(row, 0, self.geometry.height - 1), np.clip(col, 0, self.geometry.width - 1)


def make_landcover(
    terrain: SyntheticTerrain,
    config: VegetationConfig,
    seed: int,
    lakes: Sequence[BoolArray] = (),
) -> LandCover:
    """Give each cell of the terrain's surroundings (half their cell size) a class.

    Trees seek ravines and shaded slopes, grass gentle and sunny ground, bare ground steep crests; patches of noise
    break the rules up. The shares of `config` hold over the site. `lakes`: their cells on the surroundings' grid.
    """
    coarse = terrain.surroundings
    g = coarse.geometry
    fine = GridGeometry(g.x_min, g.y_max, g.resolution / 2, g.width * 2, g.height * 2)
    height = HeightField(ndimage.zoom(coarse.elevation, 2, order=1, mode="nearest", grid_mode=True), fine)
    xs, ys = height.axes()
    smooth = HeightField(ndimage.gaussian_filter(height.elevation, 4.0), fine)
    east, north = smooth.gradient()
    slope = np.hypot(east, north)
    exposure = np.clip(north / 0.5, -1, 1)
    hollow = ndimage.gaussian_filter(height.elevation, 12.0) - height.elevation  # > 0 in ravines
    ravine = np.clip(hollow / 12.0, -1.2, 1.5)
    wet = np.clip((ndimage.zoom(ndimage.maximum_filter(terrain.wetness, 5), 2, order=1) - 4.0) / 1.6, 0, 1)
    level = (height.elevation - coarse.elevation.mean()) / max(float(coarse.elevation.std()), 1.0)
    waves = (config.patch, config.patch, 0.5 * config.patch)
    patches = [noise_fields.fractal(xs, ys, w, seed + 201 + k, octaves=4, gain=0.65) for k, w in enumerate(waves)]
    broad = noise_fields.fractal(xs, ys, 1400.0, seed + 211, octaves=2)
    moisture = np.clip(0.45 * ravine + 0.4 * wet - 0.45 * exposure + 0.6 * broad, -1.5, 1.5).astype(np.float32)
    tree = moisture + 1.3 * patches[0] + 0.12 * level
    grass = (
        0.9 * np.clip(0.55 - slope, -0.4, 0.5) / 0.5 + 0.35 * exposure + 1.5 * patches[1] - 0.2 * ravine - 0.2 * broad
    )
    bare = 1.1 * np.clip(slope - 0.5, -0.4, 0.5) - 0.35 * ravine + 1.8 * patches[2] + 0.25 * exposure
    in_site = _site_mask(terrain, fine)
    classes = np.full(fine.shape, SHRUB, np.uint8)
    taken = np.zeros(fine.shape, bool)
    wishes: list[tuple[int, NDArray[Any], float]] = [
        (BARE, bare, config.bare),
        (TREE, tree, config.tree),
        (GRASS, grass, config.grass),
    ]
    for class_id, score, share in wishes:
        if share <= 0:
            continue
        free = in_site & ~taken
        wanted = min(1.0, share * float(in_site.sum()) / max(1.0, float(free.sum())))
        least = float(np.quantile(score[free], 1.0 - wanted))
        chosen = (score >= least) & ~taken
        classes[chosen] = class_id
        taken |= chosen
    wet_cells = np.zeros(fine.shape, bool)
    for lake in lakes:
        wet_cells |= np.kron(lake, np.ones((2, 2), bool))
    classes[wet_cells] = WATER
    rock = classes == BARE
    road = track(terrain, fine, seed) & ~wet_cells if config.road else np.zeros(fine.shape, bool)
    classes[road] = BARE
    houses = hamlet(terrain, road, wet_cells, fine, config.houses, seed) if config.houses else Houses.none()
    rows, cols = np.mgrid[0 : fine.height, 0 : fine.width]
    for x, y in zip(houses.x, houses.y, strict=True):
        row, col = (int(v) for v in fine.cell_of(x, y))
        window = (slice(max(0, row - 8), row + 9), slice(max(0, col - 8), col + 9))
        cx, cy = fine.to_map(rows[window], cols[window])
        reach = np.hypot(cx - x, cy - y)
        classes[window] = np.where(reach < 6.0, BUILT, np.where(reach < YARD, BARE, classes[window]))
    # Conifers hold the high, shaded ground in stands
    stands = noise_fields.fractal(xs, ys, 500.0, seed + 409, octaves=2, gain=0.5)
    conifer = np.asarray(0.5 * level - 0.5 * exposure + 0.9 * stands > 2.05 - 3 * config.conifers, np.bool_)
    stand = replace(Stand.undisturbed(fine.shape, conifer, config.density), rock=rock)
    return LandCover(classes, road, moisture, exposure.astype(np.float32), fine, stand, houses)


def _site_mask(terrain: SyntheticTerrain, geometry: GridGeometry) -> BoolArray:
    x_min, y_min, x_max, y_max = terrain.site.geometry.bounds
    x, y = geometry.to_map(np.arange(geometry.height)[:, None], np.arange(geometry.width)[None, :])
    return np.asarray((x > x_min) & (x < x_max) & (y > y_min) & (y < y_max), np.bool_)


@dataclass(frozen=True)
class PlantCells:
    """Square cells of the ground, (N,) each, and what the land cover says of them: `shares` (N, 5) by class."""

    x: Float64Array
    y: Float64Array
    side: float
    shares: Float64Array
    density: Float64Array
    shrub_height: Float64Array
    tree_height: Float64Array
    char: Float64Array
    scorch: Float64Array
    dead_shrub: BoolArray
    dead_tree: BoolArray
    rock: Float64Array
    conifer: BoolArray
    edge: BoolArray  # a change has ended inside the cell


def describe(cover: LandCover, x: Float64Array, y: Float64Array, side: float, samples: int = 3) -> PlantCells:
    """Shares of each class over square cells, from samples x samples points, and the stand at their centres."""
    stand = cover.stand
    steps = (np.arange(samples) - (samples - 1) / 2) * side / samples
    shares = np.zeros((len(x), 5))
    touched = cover.sample(stand.touched, x, y)
    edge = np.zeros(len(x), bool)
    for dx in steps:
        for dy in steps:
            shares[np.arange(len(x)), np.minimum(cover.at(x + dx, y + dy), 4)] += 1 / samples**2
            edge |= cover.sample(stand.touched, x + dx, y + dy) != touched
    names = ("density", "shrub_height", "tree_height", "char", "scorch", "rock")
    here = {n: np.asarray(cover.sample(getattr(stand, n), x, y), np.float64) for n in names}
    dead = cover.sample(stand.dead, x, y)
    conifer = cover.sample(stand.conifer, x, y) >= 0.5
    return PlantCells(
        x, y, side, shares, dead_shrub=dead == SHRUB, dead_tree=dead == TREE, conifer=conifer,
        edge=edge, **here,
    )  # fmt: skip
