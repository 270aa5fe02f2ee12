"""Terrain, trees, shrubs and towers of the exact hillside scenes."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer

SIZE = (820, 1000)
"""Rows and columns, cells of 1 m."""
GEOMETRY = GridGeometry(0.0, float(SIZE[0]), 1.0, SIZE[1], SIZE[0])
CENTRE = (500.0, 560.0)
"""(x, y) of what happens; the towers stand 500 m from it."""
TOWERS = {"west": (250.0, 127.0), "east": (750.0, 127.0)}
MAST = 25.0
_OVERLOOKED = 0.8
"""Of the ground about CENTRE that each tower must see."""
_SIGHT_LINE = 50.0
"""Metres on both sides of the line from a tower to CENTRE where no wood stands before it."""


@dataclass(frozen=True, eq=False)
class Trees:
    """Stems: x, y, height, crown radius, (N,) each."""

    x: Float64Array
    y: Float64Array
    height: Float64Array
    radius: Float64Array

    def where(self, kept: BoolArray) -> "Trees":
        return Trees(self.x[kept], self.y[kept], self.height[kept], self.radius[kept])

    def joined(self, other: "Trees") -> "Trees":
        pairs = ((self.x, other.x), (self.y, other.y), (self.height, other.height), (self.radius, other.radius))
        return Trees(*(np.concatenate(pair) for pair in pairs))


def overlooked_hillside(rng: np.random.Generator) -> Float64Array:
    """The first hillside whose middle both towers see: towers are built where they overlook what they watch."""
    x, y = np.meshgrid(CENTRE[0] + np.linspace(-40, 40, 9), CENTRE[1] + np.linspace(-40, 40, 9))
    while True:
        bare = _hillside(rng)
        dem = Dem(np.asarray(bare, np.float32), GEOMETRY)
        target = np.stack([x, y, dem.elevation_at(x, y)], axis=-1).reshape(-1, 3)
        seen = []
        for name in TOWERS:
            way = target - tower_pose(name, dem).position
            reached = TerrainTracer(dem).trace_rays(tower_pose(name, dem).position, way)
            seen.append(np.mean(reached > np.linalg.norm(way, axis=1) - 5.0))
        if min(seen) > _OVERLOOKED:
            return bare


def _hillside(rng: np.random.Generator) -> Float64Array:
    """A slope that faces the towers, with spurs and gullies; gentle where the towers stand."""
    row, col = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    _, y = GEOMETRY.to_map(row, col)
    height = 900 + 0.34 * np.maximum(y - 230.0, 0) - 0.06 * np.minimum(y, 230.0)
    for sigma, amount in ((70.0, 9.0), (22.0, 1.6), (7.0, 0.35)):
        rough = ndimage.gaussian_filter(rng.standard_normal(SIZE), sigma, mode="reflect")
        height = height + amount * rough / rough.std()
    return np.asarray(height, np.float64)


def planted(rng: np.random.Generator, east: tuple[float, float], north: tuple[float, float], height: float) -> Trees:
    """A stand about CENTRE with a stem every 4 m or so."""
    x, y = np.meshgrid(np.arange(*east, 4.0), np.arange(*north, 4.0))
    x, y = (CENTRE[i] + a.ravel() + rng.uniform(-1.2, 1.2, a.size) for i, a in enumerate((x, y)))
    tall = rng.normal(height, height / 10, x.size).clip(height / 2)
    return Trees(x, y, tall, 0.9 + 0.1 * tall)


def stands(rng: np.random.Generator) -> Trees:
    """Woods on about a third of the slope, none near the towers or in their lines of sight."""
    wooded = ndimage.gaussian_filter(rng.standard_normal(SIZE), 35, mode="reflect")
    wooded = wooded > np.quantile(wooded, 0.62)
    x, y = np.meshgrid(np.arange(3.0, SIZE[1] - 3, 4.5), np.arange(260.0, SIZE[0] - 3, 4.5))
    x, y = (a.ravel() + rng.uniform(-1.5, 1.5, a.size) for a in (x, y))
    row, col = GEOMETRY.cell_of(x, y)
    kept = wooded[row.clip(0, SIZE[0] - 1), col.clip(0, SIZE[1] - 1)]
    for tower in TOWERS.values():
        way = np.subtract(CENTRE, tower)
        length = float(np.hypot(*way))
        along = ((x - tower[0]) * way[0] + (y - tower[1]) * way[1]) / length
        aside = ((x - tower[0]) * way[1] - (y - tower[1]) * way[0]) / length
        kept &= (along > length - _SIGHT_LINE) | (np.abs(aside) > _SIGHT_LINE)
    tall = rng.normal(11.0, 2.0, x.size).clip(4)
    return Trees(x, y, tall, 0.9 + 0.12 * tall).where(kept)


def shrubs(rng: np.random.Generator) -> Float64Array:
    """Brush up to 2 m, in patches."""
    patch = ndimage.gaussian_filter(rng.standard_normal(SIZE), 18, mode="reflect")
    lump = ndimage.gaussian_filter(rng.standard_normal(SIZE), 1.5, mode="reflect")
    height = 1.2 + 0.5 * lump / lump.std()
    return np.asarray(np.where(patch > np.quantile(patch, 0.7), height.clip(0, 2.0), 0.0))


def canopy(trees: Trees) -> Float64Array:
    """Height of the crowns over the ground, (H, W): paraboloids on their stems."""
    canopy = np.zeros(SIZE)
    rows, cols = GEOMETRY.to_grid(trees.x, trees.y)
    for row, col, height, radius in zip(rows, cols, trees.height, trees.radius, strict=True):
        reach = math.ceil(radius)
        r0, r1 = max(int(row) - reach, 0), min(int(row) + reach + 2, SIZE[0])
        c0, c1 = max(int(col) - reach, 0), min(int(col) + reach + 2, SIZE[1])
        if r0 >= r1 or c0 >= c1:
            continue
        r, c = np.mgrid[r0:r1, c0:c1]
        far = ((r - row) ** 2 + (c - col) ** 2) / radius**2
        crown = np.where(far < 1, height * (1 - 0.55 * far), 0.0)
        canopy[r0:r1, c0:c1] = np.maximum(canopy[r0:r1, c0:c1], crown)
    return canopy


def coarse(heights: Float64Array, factor: int) -> Float64Array:
    """As a raster `factor` times as coarse has it, bilinear between its cells."""
    rows, cols = SIZE[0] // factor, SIZE[1] // factor
    means = heights[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor).mean(axis=(1, 3))
    row = (np.arange(SIZE[0]) + 0.5) / factor - 0.5
    col = (np.arange(SIZE[1]) + 0.5) / factor - 0.5
    return np.asarray(
        ndimage.map_coordinates(means, np.meshgrid(row, col, indexing="ij"), order=1, mode="nearest"), np.float64
    )


def tower_pose(name: str, surface: Dem) -> Pose:
    """A tower's true pose: MAST metres over the ground, towards CENTRE."""
    x, y = TOWERS[name]
    z = float(surface.elevation_at(x, y)) + MAST
    dx, dy = CENTRE[0] - x, CENTRE[1] - y
    target = float(surface.elevation_at(*CENTRE))
    pitch = math.degrees(math.atan2(target - z, math.hypot(dx, dy)))
    return Pose.from_angles((x, y, z), math.degrees(math.atan2(dx, dy)), pitch, 0.8)
