"""Where which vegetation stands: the class map of a synthetic site."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from ltm_core.grid import GridGeometry
from ltm_core.simulator import noise
from ltm_core.simulator.scenario import VegetationConfig
from ltm_core.simulator.terrain import HeightField, Terrain

SKY, GRASS, SHRUB, TREE, BARE, WATER, BUILT = 0, 1, 2, 3, 4, 5, 6  # ids of config/labels.yaml
UNLABELLED = 255

Field = NDArray[np.float32]


@dataclass(frozen=True)
class Stand:
    """The state of the plants, cell by cell of the land cover.

    `shrub_height`, `tree_height`: relative to mature ones. `density`: plants relative to closed cover. `conifer`:
    which trees stand where trees stand. `char` 0..1: black ground. `scorch` 0..1: tree crowns killed by heat. `dead`:
    class id of what fire has left standing dead (SHRUB, TREE), else 0. `rock`: bare ground is of stone.
    """

    shrub_height: Field
    tree_height: Field
    density: Field
    conifer: NDArray[np.bool_]
    char: Field
    scorch: Field
    dead: NDArray[np.uint8]
    rock: NDArray[np.bool_]

    @staticmethod
    def undisturbed(shape: tuple[int, int], conifer: NDArray[np.bool_] | None = None, density: float = 1.0) -> Stand:
        """Mature plants, no traces of fire, stone wherever the ground is bare."""
        zeros, ones = np.zeros(shape, np.float32), np.ones(shape, np.float32)
        if conifer is None:
            conifer = np.zeros(shape, bool)
        dead, rock = np.zeros(shape, np.uint8), np.ones(shape, bool)
        return Stand(ones, ones, density * ones, conifer, zeros, zeros, dead, rock)


@dataclass(frozen=True)
class LandCover:
    """Class ids (H, W) uint8 on `geometry` (map frame), and what the placing of plants needs beside them.

    `road`: the cells of the track. `moisture`: about [-1, 1], ravines and shaded slopes high. `exposure`: [-1,
    1], 1 steep and facing south.
    """

    classes: NDArray[np.uint8]
    road: NDArray[np.bool_]
    moisture: Field
    exposure: Field
    geometry: GridGeometry
    stand: Stand

    def at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.uint8]:
        """Class ids at map points; the nearest cell's outside."""
        row, col = self.geometry.cell_of(x, y)
        rows = np.clip(row, 0, self.geometry.height - 1)
        return np.asarray(self.classes[rows, np.clip(col, 0, self.geometry.width - 1)], np.uint8)

    def on_road(self, x: ArrayLike, y: ArrayLike, side: float) -> NDArray[np.bool_]:
        """Whether the track passes through the square of `side` about each map point, as far as its corners and
        centre tell."""
        h = side / 2
        hit = np.zeros(np.shape(x), bool)
        for dx, dy in ((0, 0), (-h, -h), (h, -h), (-h, h), (h, h)):
            row, col = self.geometry.cell_of(np.add(x, dx), np.add(y, dy))
            rows = np.clip(row, 0, self.geometry.height - 1)
            hit |= self.road[rows, np.clip(col, 0, self.geometry.width - 1)]
        return hit

    def sample(self, field: NDArray[Any], x: ArrayLike, y: ArrayLike) -> Field:
        """A raster of this geometry at map points, nearest cell."""
        row, col = self.geometry.cell_of(x, y)
        rows = np.clip(row, 0, self.geometry.height - 1)
        return np.asarray(field[rows, np.clip(col, 0, self.geometry.width - 1)], np.float32)


def make_landcover(terrain: Terrain, config: VegetationConfig, seed: int) -> LandCover:
    """Give each cell of the terrain's surroundings (half their cell size) a class.

    Trees seek ravines and shaded slopes, grass gentle and sunny ground, bare ground steep crests; patches of
    noise break the rules up. The
    shares of `config` hold over the site.
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
    patches = [noise.fractal(xs, ys, w, seed + 201 + k, octaves=4, gain=0.65) for k, w in enumerate(waves)]
    broad = noise.fractal(xs, ys, 1400.0, seed + 211, octaves=2)
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
    road = _track(terrain, fine, seed) if config.road else np.zeros(fine.shape, bool)
    classes[road] = BARE
    # Conifers hold the high, shaded ground in stands
    stands = noise.fractal(xs, ys, 500.0, seed + 409, octaves=2, gain=0.5)
    conifer = np.asarray(0.5 * level - 0.5 * exposure + 0.9 * stands > 2.05 - 3 * config.conifers, np.bool_)
    stand = Stand.undisturbed(fine.shape, conifer, config.density)
    return LandCover(classes, road, moisture, exposure.astype(np.float32), fine, stand)


def _site_mask(terrain: Terrain, geometry: GridGeometry) -> NDArray[np.bool_]:
    x_min, y_min, x_max, y_max = terrain.site.geometry.bounds
    x, y = geometry.to_map(np.arange(geometry.height)[:, None], np.arange(geometry.width)[None, :])
    return np.asarray((x > x_min) & (x < x_max) & (y > y_min) & (y < y_max), np.bool_)


def _track(terrain: Terrain, geometry: GridGeometry, seed: int) -> NDArray[np.bool_]:
    """A dirt track over the range: the cheapest way between two borders where climbing and cross slopes cost, two
    cells wide."""
    step = 4
    wide, g = terrain.surroundings.geometry, terrain.site.geometry
    (top, bottom), (left, right) = (
        np.clip(v, 0, wide.width) for v in wide.cell_of([g.x_min, g.x_max], [g.y_max, g.y_min])
    )
    z = terrain.surroundings.elevation[top:bottom:step, left:right:step].astype(np.float64)
    cell = wide.resolution * step
    rows, cols = z.shape
    index = np.arange(rows * cols).reshape(rows, cols)
    starts, ends, costs = [], [], []
    pairs: list[tuple[int, int]] = [(0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1)]
    for dr, dc in pairs:
        here = (slice(0, rows - dr), slice(max(0, -dc), cols - max(0, dc)))
        there = (slice(dr, rows), slice(max(0, dc), cols - max(0, -dc)))
        length = cell * np.hypot(dr, dc)
        grade = np.abs(z[there] - z[here]) / length
        starts.append(index[here].ravel())
        ends.append(index[there].ravel())
        costs.append((length * (1.0 + (grade / 0.11) ** 2)).ravel())
    graph = sparse.coo_matrix(
        (np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends))), shape=(index.size, index.size)
    ).tocsr()
    rng = np.random.default_rng([seed, 5])
    begin = index[int(rows * rng.uniform(0.35, 0.65)), 0]
    end = index[int(rows * rng.uniform(0.35, 0.65)), cols - 1]
    _, before = csgraph.dijkstra(graph, directed=False, indices=begin, return_predecessors=True)
    path = [int(end)]
    while path[-1] != begin:
        path.append(int(before[path[-1]]))
    at = np.array([divmod(i, cols) for i in path], np.float64)
    at = ndimage.gaussian_filter1d(at, 1.2, axis=0, mode="nearest")
    t = np.linspace(0, len(at) - 1, len(at) * 24)
    r = np.interp(t, np.arange(len(at)), at[:, 0]) * step * 2 + 2 * top
    c = np.interp(t, np.arange(len(at)), at[:, 1]) * step * 2 + 2 * left
    mask = np.zeros(geometry.shape, bool)
    mask[
        np.clip(np.rint(r), 0, geometry.height - 1).astype(int), np.clip(np.rint(c), 0, geometry.width - 1).astype(int)
    ] = True
    return np.asarray(ndimage.binary_dilation(mask), np.bool_)
