"""Terrain scenes that tests share: some with a closed-form surface, some rough but seeded. No raster is square or
symmetric.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ltm_core.base.types import Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem

Surface = Callable[[Float64Array, Float64Array], Float64Array]


@dataclass(frozen=True)
class Scene:
    """A DEM, and the surface that it samples, height(x, y) in metres."""

    dem: Dem
    surface: Surface


def sampled(surface: Surface, geometry: GridGeometry) -> Scene:
    """The scene of `surface` at the cell centres of `geometry`."""
    row, col = np.mgrid[0 : geometry.height, 0 : geometry.width]
    x, y = geometry.to_map(row, col)
    return Scene(Dem(surface(x, y).astype(np.float32), geometry), surface)


def tilted_plane(east: float = 0.31, north: float = -0.17, base: float = 420.0, resolution: float = 2.0) -> Scene:
    """A plane that rises by `east` and `north` metres a metre from height `base` at (0, 0); 600 x 424 m about the
    origin.
    """
    geometry = GridGeometry(-300.0, 212.0, resolution, round(600 / resolution), round(424 / resolution))
    return sampled(lambda x, y: base + east * x + north * y, geometry)


def cone(slope: float = 0.6, tip: float = 150.0, resolution: float = 0.25) -> Scene:
    """A cone with its tip at (0, 0, `tip`), 250 x 200 m; the bilinear surface is within 0.3 mm of it 15 m from the
    tip.
    """
    geometry = GridGeometry(-125.0, 100.0, resolution, round(250 / resolution), round(200 / resolution))
    return sampled(lambda x, y: tip - slope * np.hypot(x, y), geometry)


RIDGE_X = (-400.0, 0.0, 200.0, 500.0, 900.0)
"""Easting of the breaks of `ridge`: foot, crest, valley's near edge, far edge, top of the far slope."""
RIDGE_Z = (100.0, 260.0, 40.0, 40.0, 300.0)


def ridge(resolution: float = 4.0) -> Scene:
    """A north-south ridge with a valley behind it, in profile RIDGE_X, RIDGE_Z; its breaks lie on cell centres, so
    that the bilinear surface is exact."""
    width = round(1300 / resolution) + 1
    geometry = GridGeometry(
        -400.0 - resolution / 2, 240.0 + resolution / 2, resolution, width, round(480 / resolution) + 1
    )
    return sampled(lambda x, y: np.interp(x, RIDGE_X, RIDGE_Z) + 0.0 * y, geometry)


def rough_terrain(
    seed: int,
    shape: tuple[int, int] = (181, 263),
    resolution: float = 1.0,
    relief: float = 60.0,
    x_min: float = 0.0,
    y_max: float = 0.0,
) -> Dem:
    """Seeded fractal terrain with peaks, ridges and pits down to single cells."""
    rng = np.random.default_rng(seed)
    height = np.zeros(shape)
    sigma, weight = max(shape) / 6, 1.0
    while sigma > 0.7:
        noise = ndimage.gaussian_filter(rng.standard_normal(shape), sigma, mode="reflect")
        height += weight * noise / noise.std()
        sigma, weight = sigma / 2, weight * 0.45
    height = 800.0 + relief * (height - height.min()) / np.ptp(height)
    return Dem(height.astype(np.float32), GridGeometry(x_min, y_max, resolution, shape[1], shape[0]))


def with_holes(dem: Dem, seed: int, enclosed: int = 12, specks: int = 60, margin: bool = True) -> Dem:
    """`dem` with nodata: `enclosed` lakes of a few cells across, single-cell `specks`, and a slanting nodata margin."""
    rng = np.random.default_rng(seed)
    elevation = dem.elevation.copy()
    rows, cols = np.mgrid[0 : elevation.shape[0], 0 : elevation.shape[1]]
    for _ in range(enclosed):
        row, col = (rng.integers(8, n - 8) for n in elevation.shape)
        a, b = rng.uniform(1.0, 7.0, 2)
        elevation[((rows - row) / a) ** 2 + ((cols - col) / b) ** 2 < 1] = np.nan
    elevation[rng.integers(0, elevation.shape[0], specks), rng.integers(0, elevation.shape[1], specks)] = np.nan
    if margin:
        elevation[cols + 3 * rows < 0.35 * elevation.shape[1]] = np.nan
        elevation[cols - 0.3 * rows > 0.93 * elevation.shape[1]] = np.nan
    return Dem(elevation, dem.geometry)


def standing(dem: Dem, row: float, col: float, above: float) -> Float64Array:
    """A position (3,) `above` metres over the ground at fractional (row, col)."""
    x, y = dem.geometry.to_map(row, col)
    return np.array([float(x), float(y), float(dem.elevation_at(x, y)) + above])


def directions(rng: np.random.Generator, count: int, low_deg: float = -25.0, high_deg: float = 12.0) -> Float64Array:
    """Unit vectors (count, 3) with azimuth and elevation angle uniform at random."""
    azimuth = rng.uniform(0, 2 * np.pi, count)
    elevation = np.radians(rng.uniform(low_deg, high_deg, count))
    flat = np.cos(elevation)
    return np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], axis=-1)
