"""Sites for smoke trials: the true ground, a terrain model with errors of a stated sigma, and towers."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem

MAST = 12.0
"""Metres of a camera above the true ground."""
TOWERS = 30
_LEAST_CLEARANCE = 1.0
"""Smallest height of a given camera above the true ground, metres."""
_APART = 2_000.0
_CORRELATION = 2.0  # cells: of the model's error
_AROUND = 1_000.0  # metres: a summit stands above the mean of what is so near


@dataclass(frozen=True, eq=False)
class SmokeSite:
    """`truth`: the ground, in a map frame of small coordinates. `model`: what is known of it. `towers`: (T, 3) true
    positions of cameras."""

    name: str
    truth: Dem
    model: Dem
    towers: Float64Array


def smoke_site(name: str, dem: Dem, error: float, seed: int, towers: Float64Array | None = None) -> SmokeSite:
    """Return a site whose model is the DEM, and whose truth differs by correlated errors of `error` metres (sigma).

    `towers` are (T, 3) places of cameras; by default they are found on summits. Raises ConfigError if there is no room
    for three."""
    rng = np.random.default_rng([seed, 1])
    x, y = round(dem.geometry.x_min / 1000) * 1000.0, round(dem.geometry.y_min / 1000) * 1000.0
    g = dem.geometry.translated(-x, -y)
    model = Dem(dem.elevation, GridGeometry(g.x_min, g.y_max, g.resolution, g.width, g.height))
    noise = ndimage.gaussian_filter(rng.standard_normal(dem.elevation.shape, np.float32), _CORRELATION)
    truth = Dem(dem.elevation + noise * np.float32(error / noise.std()), model.geometry)
    if towers is None:
        towers = _towers(truth, rng, name)
    else:
        towers = towers - (x, y, 0.0)
        towers = towers[towers[:, 2] - truth.elevation_at(towers[:, 0], towers[:, 1]) > _LEAST_CLEARANCE]
    return SmokeSite(name, truth, model, towers)


def _towers(truth: Dem, rng: np.random.Generator, name: str) -> Float64Array:
    """Return the summits that stand highest above their surroundings, each with room around it."""
    g = truth.geometry
    known = np.isfinite(truth.elevation)
    heights = np.where(known, truth.elevation, 0.0)
    size = max(3, round(2 * _AROUND / g.resolution))
    share = ndimage.uniform_filter(known.astype(np.float32), size, mode="constant")
    mean = ndimage.uniform_filter(heights, size, mode="constant") / np.maximum(share, 1e-3)
    edge = round(_AROUND / g.resolution)
    rows = rng.integers(edge, g.height - edge, 20_000)
    cols = rng.integers(edge, g.width - edge, 20_000)
    above = np.where(known & (share > 0.999), heights - mean, -np.inf)[rows, cols]
    order = np.argsort(-above)
    chosen: list[tuple[float, float, float]] = []
    for at in order[np.isfinite(above[order]) & (above[order] > 0)]:
        x, y = (float(v) for v in g.to_map(rows[at], cols[at]))
        if all(np.hypot(x - px, y - py) >= _APART for px, py, _ in chosen):
            chosen.append((x, y, float(truth.elevation_at(x, y)) + MAST))
        if len(chosen) == TOWERS:
            break
    if len(chosen) < 3:
        raise ConfigError(f"{name}: no three summits {_APART:g} m apart, it is too small for smoke trials")
    return np.array(chosen)


def ranged_mountains(seed: int, size: int = 1_600, resolution: float = 12.5) -> Dem:
    """Synthetic ridges of 20 km: ridged multifractal noise as in `bench.mountains`, here by seed, at any cell size."""
    rng = np.random.default_rng([seed, 2])
    total, weight = np.zeros((size, size), np.float32), np.ones((size, size), np.float32)
    amplitude, wavelength = 1.0, 3_600.0
    while wavelength > 4 * resolution:
        count = int(np.ceil(size * resolution / wavelength)) + 4
        lattice = rng.standard_normal((count, count)).astype(np.float32)
        zoom = wavelength / resolution
        offset = rng.uniform(0, 2, 2)
        at = np.arange(size) / zoom
        rows, cols = np.meshgrid(at + offset[0], at + offset[1], indexing="ij")
        field = ndimage.map_coordinates(lattice, [rows, cols], order=3, mode="nearest")
        ridge = np.maximum(1.0 - np.abs(field) * 0.9, 0.0).astype(np.float32)
        ridge = ridge**2 * weight
        total += ridge * np.float32(amplitude)
        weight = np.clip(ridge * 1.7, 0.0, 1.0)
        amplitude, wavelength = amplitude * 0.42, wavelength / 2.03
    heights = 250.0 + 420.0 * total
    return Dem(heights.astype(np.float32), GridGeometry(0.0, size * resolution, resolution, size, size))
