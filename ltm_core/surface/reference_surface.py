"""Reference surface: heights, cells and slopes of the DEM and of objects on it, and each pixel's expected view of it.

None of that view depends on the image, so it is kept, and a camera that stands still pays for it once."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float32Array, Float64Array, RecordArray
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.surface.cell_layout import CELLS, PLACE_BITS, TILE, TILE_BITS, place_of

LEAST_INCIDENCE = 0.1
"""Minimum incidence factor: the height of a grazing ray does not depend on its range, but it is not exact either."""


class ReferenceGrid(NamedTuple):
    """Grids of a reference: `surface`, `bare`: (H, W) metres, with objects on the ground and without; `east`, `north`:
    rise per metre of blocks of `block` cells a side; `across`: tiles."""

    surface: Float32Array
    bare: Float32Array
    east: Float32Array
    north: Float32Array
    block: int
    x_min: float
    y_max: float
    resolution: float
    across: int


@helper(inline="always")
def height_at(ground: ReferenceGrid, x: float, y: float) -> float:
    """Return the bilinear height; NaN outside the outermost cell centres."""
    col = (x - ground.x_min) / ground.resolution - 0.5
    row = (ground.y_max - y) / ground.resolution - 0.5
    height, width = ground.surface.shape
    if not (row >= 0.0 and col >= 0.0 and row <= height - 1.0 and col <= width - 1.0):
        return math.nan
    r = min(int(row), height - 2)
    c = min(int(col), width - 2)
    fr, fc = row - r, col - c
    z = ground.surface
    north = z[r, c] + fc * (z[r, c + 1] - z[r, c])
    south = z[r + 1, c] + fc * (z[r + 1, c + 1] - z[r + 1, c])
    height_here: float = north + fr * (south - north)
    return height_here


@helper(inline="always")
def cell_at(ground: ReferenceGrid, x: float, y: float) -> tuple[int, int]:
    """Return the row and column of a place; -1, -1 outside."""
    col = math.floor((x - ground.x_min) / ground.resolution)
    row = math.floor((ground.y_max - y) / ground.resolution)
    height, width = ground.surface.shape
    if not (row >= 0 and col >= 0 and row < height and col < width):
        return -1, -1
    return int(row), int(col)


@helper(inline="always")
def stood_at(ground: ReferenceGrid, place: int) -> float:
    """Return the height in metres of the object in a cell."""
    tile, k = place >> PLACE_BITS, place & (CELLS - 1)
    row = ((tile // ground.across) << TILE_BITS) + (k >> TILE_BITS)
    col = ((tile % ground.across) << TILE_BITS) + (k & (TILE - 1))
    height: float = ground.surface[row, col] - ground.bare[row, col]
    return height


@helper()
def slopes_at(ground: ReferenceGrid, row: int, col: int) -> tuple[float, float]:
    r, c = row // ground.block, col // ground.block
    return np.float64(ground.east[r, c]), np.float64(ground.north[r, c])


@helper()
def steepness(ground: ReferenceGrid, r: int, c: int, dx: float, dy: float, dz: float) -> float:
    """Return the incidence factor on the cell's own slope; 0 where that is not known."""
    height, width = ground.surface.shape
    z, step = ground.surface, 2 * ground.resolution
    east = (z[r, min(c + 1, width - 1)] - z[r, max(c - 1, 0)]) / step
    north = (z[max(r - 1, 0), c] - z[min(r + 1, height - 1), c]) / step
    steep: float = abs(dz - east * dx - north * dy)
    return steep if steep < math.inf else 0.0


@helper()
def pose_variance(covariance: Float64Array, east: float, north: float, px: float, py: float, pz: float) -> float:
    """Return the variance of the height of a surface with these slopes, seen at (px, py, pz) from the camera: the row
    of the camera's shift o and turn w in n.(o + w x p) / n_z is [n, p x n] / n_z, with n / n_z = (-east, -north, 1)."""
    nx, ny = -east, -north
    row = (nx, ny, 1.0, py - pz * ny, pz * nx - px, px * ny - py * nx)
    total = 0.0
    for i in range(6):
        part = 0.0
        for j in range(6):
            part += covariance[i, j] * row[j]
        total += row[i] * part
    return max(total, 0.0)


EXPECTED_PIXEL = np.dtype(
    [("expected", "f4"), ("nearest", "f4"), ("farthest", "f4"), ("spread", "f4"), ("place", "i4"), ("incidence", "f4"),
     ("steep", "f4"), ("pose_variance", "f4")]
)  # fmt: skip
"""Expected view of one pixel: the slant range that the reference predicts, its extremes within the pose's uncertainty,
and half of its variation within the pixel (metres); the index of the visible cell (-1: none); the incidence factor on
the slope of its block, and the larger of that and the one on its own slope; and the variance of its height due to the
pose."""


class CameraView(NamedTuple):
    """One frame's camera: rays (H, W, 3) in the optical frame, rotation to the map, position, pose covariance, and the
    bend of a ray over its horizontal range."""

    rays: Float64Array
    rotation: Float64Array
    position: Float64Array
    covariance: Float64Array
    bend: float


class Extremes(NamedTuple):
    """Least and greatest of the expected ranges (H, W), unknown ones counted as infinite: within the pose's
    uncertainty, and within one pixel."""

    nearest: Float32Array
    farthest: Float32Array
    near: Float32Array
    far: Float32Array


@helper(inline="always")
def direction(view: CameraView, v: int, u: int) -> tuple[float, float, float]:
    """Return the unit vector of a pixel's ray in the map frame."""
    m = view.rotation
    a, b, c = view.rays[v, u, 0], view.rays[v, u, 1], view.rays[v, u, 2]
    dx, dy = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c, m[1, 0] * a + m[1, 1] * b + m[1, 2] * c
    return dx, dy, m[2, 0] * a + m[2, 1] * b + m[2, 2] * c


@kernel()
def predict_view(
    ground: ReferenceGrid, view: CameraView, expected: Float32Array, extremes: Extremes, pixels: RecordArray
) -> None:
    """Fill `pixels` (H, W) of EXPECTED_PIXEL with each pixel's view of the reference."""
    rows, cols = expected.shape
    x0, y0 = view.position[0], view.position[1]
    for v in range(rows):
        for u in range(cols):
            one = pixels[v, u]
            e = float(expected[v, u])
            one.expected = e
            one.nearest, one.farthest = extremes.nearest[v, u], extremes.farthest[v, u]
            one.place = -1
            one.spread = one.incidence = one.steep = one.pose_variance = 0.0
            if not e < math.inf:
                continue
            # Where neighbouring pixels see other ranges, a pixel's own direction is not exact enough.
            if not math.isinf(extremes.far[v, u]):
                one.spread = 0.5 * (extremes.far[v, u] - extremes.near[v, u])
            elif not math.isinf(extremes.near[v, u]):
                one.spread = e - extremes.near[v, u]
            dx, dy, dz = direction(view, v, u)
            x, y = x0 + dx * e, y0 + dy * e
            row, col = cell_at(ground, x, y)
            if row < 0:
                continue
            east, north = slopes_at(ground, row, col)
            incidence = max(abs(dz - east * dx - north * dy), LEAST_INCIDENCE)
            one.place = place_of(row, col, ground.across)
            one.incidence = incidence
            one.steep = max(incidence, steepness(ground, row, col, dx, dy, dz))
            z = dz * e + view.bend * (dx * dx + dy * dy) * e * e
            one.pose_variance = pose_variance(view.covariance, east, north, x - x0, y - y0, z)


BLOCK = 8
"""Number of cells per side over which the slope of the surface is computed; crowns and boulders have slopes, but no
incidence."""
LARGEST = 50_000_000
"""Maximum number of cells of a site; heights, slopes and the tracer's pyramid of more would fill the memory of a tower
computer."""
_ROWS = 256


class Slopes(NamedTuple):
    """Rise per metre to the east and to the north of blocks of BLOCK x BLOCK cells, (h, w) each; 0 where unknown."""

    east: Float32Array
    north: Float32Array


@dataclass(frozen=True, eq=False)
class Reference:
    """Two hypotheses on one grid, in the map frame.

    `bare`: bare earth, (H, W) metres, never changed. `surface`: with canopy and buildings; the same array where no
    surface raster is known (`canopy_known` False): then the first consistent observations of a cell become its
    canopy, and only what contradicts those, or lies below bare earth, is change."""

    bare: Float32Array
    surface: Float32Array
    geometry: GridGeometry
    slopes: Slopes

    @property
    def canopy_known(self) -> bool:
        return self.surface is not self.bare

    @classmethod
    def of(cls, bare: Dem, surface: Dem | None = None, resolution: float | None = None) -> "Reference":
        """Return both hypotheses at the cell centres of a grid over `bare` with cells of `resolution` (default: its
        own); bare earth where the surface raster is unknown or below it. Raises ConfigError if the grid has too many
        cells."""
        whole = bare.geometry
        cell = resolution or whole.resolution
        height = max(2, round(whole.height * whole.resolution / cell))
        width = max(2, round(whole.width * whole.resolution / cell))
        if height * width > LARGEST:
            side = (whole.height * whole.width * whole.resolution**2 / LARGEST) ** 0.5
            raise ConfigError(
                f"a terrain of {width} x {height} cells of {cell} m is too large (at most {LARGEST:,} cells): set "
                f"terrain.resolution to {side:.1f} m or more"
            )
        geometry = GridGeometry(whole.x_min, whole.y_max, cell, width, height, whole.crs)
        ground = _sampled(bare, geometry)
        top = ground
        if surface is not None:
            above = _sampled(surface, geometry)
            top = np.empty_like(ground)
            for row in range(0, height, _ROWS):
                part = slice(row, row + _ROWS)
                np.fmax(above[part], ground[part], out=top[part])
        return cls(ground, top, geometry, _slopes(top, cell))


def _sampled(source: Dem, geometry: GridGeometry) -> Float32Array:
    if source.geometry == geometry:
        return source.elevation
    heights = np.empty(geometry.shape, np.float32)
    cols = np.arange(geometry.width)
    for row in range(0, geometry.height, _ROWS):
        rows = np.arange(row, min(row + _ROWS, geometry.height))
        x, y = geometry.to_map(rows[:, None], cols[None, :])
        x, y = np.broadcast_arrays(x, y)
        # The outermost half cell has no bilinear height: it takes that of the outermost cell centres.
        inner = source.geometry
        half = inner.resolution / 2 + 1e-6
        heights[rows] = source.elevation_at(
            np.clip(x, inner.x_min + half, inner.x_max - half), np.clip(y, inner.y_min + half, inner.y_max - half)
        )
    return heights


def _slopes(surface: Float32Array, resolution: float) -> Slopes:
    """Return the differences between the means of neighbouring blocks."""
    height, width = (max(1, -(-n // BLOCK)) for n in surface.shape)
    means = np.full((height, width), np.nan, np.float32)
    for row in range(height):
        strip = surface[row * BLOCK : (row + 1) * BLOCK]
        known = np.isfinite(strip)
        edges = np.arange(0, surface.shape[1], BLOCK)
        sums = np.add.reduceat(np.where(known, strip, 0).sum(axis=0, dtype=np.float64), edges)
        counts = np.add.reduceat(known.sum(axis=0), edges)
        means[row] = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    # A raster of one block has no slope along that side.
    step, sides = BLOCK * resolution, tuple(np.repeat(means, 1 + (n == 1), axis) for axis, n in enumerate(means.shape))
    north, east = (np.gradient(side, step, axis=axis)[:height, :width] for axis, side in enumerate(sides))
    return Slopes(*(np.nan_to_num(rise.astype(np.float32)) for rise in (east, -north)))
