"""Built features of a site: a dirt track, hamlets beside it, reservoirs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator.scenario import LakeConfig
from ltm_lab.simulator.terrain_synthesis import HeightField, SyntheticTerrain

_STEEPEST = 0.22  # tangent of the slope that a house stands on
_SPACING = 24.0  # m between houses
YARD = 11.0  # m of bare ground about a house


@dataclass(frozen=True)
class Houses:
    """House centres (N,) on the map and the way each faces (radians)."""

    x: Float64Array
    y: Float64Array
    turn: Float64Array

    @staticmethod
    def none() -> "Houses":
        """No house."""
        return Houses(np.empty(0), np.empty(0), np.empty(0))


def with_lakes(terrain: SyntheticTerrain, lakes: Sequence[LakeConfig]) -> tuple[SyntheticTerrain, list[BoolArray]]:
    """The ground with each lake filled to its level behind an earth dam, and its cells on the surroundings' grid.

    Raises ConfigError where a lake lies outside the ground.
    """
    wide, site = terrain.surroundings, terrain.site
    masks: list[BoolArray] = []
    for i, lake in enumerate(lakes):
        row, col = (int(v) for v in wide.geometry.cell_of(lake.x, lake.y))
        if not wide.geometry.contains(row, col):
            raise ConfigError(f"lakes.{i}: ({lake.x:g}, {lake.y:g}) is outside the site; place it inside")
        level = float(wide.elevation[row, col]) + lake.depth
        labels, _ = ndimage.label((wide.elevation < level) & (_reach(wide, lake) < lake.radius))
        water = labels == labels[row, col]
        near = ndimage.binary_dilation(water, iterations=2)
        x, y = np.meshgrid(*site.axes())
        r, c = wide.geometry.cell_of(x, y)
        on_site = near[np.clip(r, 0, near.shape[0] - 1), np.clip(c, 0, near.shape[1] - 1)]
        wide, site = _filled(wide, lake, level, near), _filled(site, lake, level, on_site)
        masks.append(water)
    return (SyntheticTerrain(site, wide, terrain.wetness) if lakes else terrain), masks


def _reach(field: HeightField, lake: LakeConfig) -> Float64Array:
    x, y = np.meshgrid(*field.axes())
    return np.asarray(np.hypot(x - lake.x, y - lake.y), np.float64)


def _filled(field: HeightField, lake: LakeConfig, level: float, near: BoolArray) -> HeightField:
    reach = _reach(field, lake)
    z = field.elevation.astype(np.float64)
    water = near & (z < level) & (reach < lake.radius)
    # Where the ground beyond the circle is too low: a crest ten metres wide and a face of one in two
    dam = ndimage.distance_transform_edt(~water) * field.geometry.resolution < 25.0 + 6 * lake.depth
    crest = level + 1.2 - np.maximum(reach - lake.radius - 10.0, 0) / 2
    raised = dam & ~water & (reach >= lake.radius)
    z = np.where(water, level, np.where(raised, np.maximum(z, crest), z))
    return HeightField(z.astype(np.float32), field.geometry)


def hamlet(
    terrain: SyntheticTerrain, road: BoolArray, blocked: BoolArray, geometry: GridGeometry, count: int, seed: int
) -> Houses:
    """Up to `count` houses in groups on gentle ground within sight of the track (or anywhere, where there is none)."""
    rng = np.random.default_rng([seed, 91])
    g = terrain.site.geometry
    x, y = geometry.to_map(*np.mgrid[0 : geometry.height, 0 : geometry.width])
    inside = (x > g.x_min + 60) & (x < g.x_max - 60) & (y > g.y_min + 60) & (y < g.y_max - 60)
    east, north = HeightField(ndimage.gaussian_filter(terrain.site.elevation, 8.0 / g.resolution), g).gradient()
    r, c = g.cell_of(x, y)
    slope = np.hypot(east, north)[np.clip(r, 0, g.height - 1), np.clip(c, 0, g.width - 1)]
    free = inside & (slope < _STEEPEST) & ~ndimage.binary_dilation(blocked, iterations=4)
    if np.any(road):
        distance = ndimage.distance_transform_edt(~road) * geometry.resolution
        free &= (distance > 14) & (distance < 160)
    rows, cols = np.nonzero(free)
    chosen: list[tuple[float, float]] = []
    while len(rows) and len(chosen) < count:
        k = int(rng.integers(len(rows)))
        center = np.array([x[rows[k], cols[k]], y[rows[k], cols[k]]])
        close = np.hypot(x[rows, cols] - center[0], y[rows, cols] - center[1]) < 70
        group = rng.permutation(np.flatnonzero(close))
        placed = 0
        for i in group:
            at = (float(x[rows[i], cols[i]]), float(y[rows[i], cols[i]]))
            if all(np.hypot(at[0] - p[0], at[1] - p[1]) > _SPACING for p in chosen):
                chosen.append(at)
                placed += 1
                if placed == 6 or len(chosen) == count:
                    break
        keep = ~close
        rows, cols = rows[keep], cols[keep]
    places = np.array(chosen, np.float64).reshape(-1, 2)
    return Houses(places[:, 0], places[:, 1], (np.pi / 4) * rng.integers(0, 8, len(places)).astype(np.float64))


def track(terrain: SyntheticTerrain, geometry: GridGeometry, seed: int) -> BoolArray:
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
