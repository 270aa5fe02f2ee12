"""Makes the DEM that the system is given: an older, coarser survey of the true ground, with errors."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ltm_core.base.types import Float32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.scenario import OutdatedDemConfig
from ltm_lab.simulator.terrain_synthesis import HeightField

_QUANTUM = 1 / 16  # m; a binary fraction deflates well


def outdated_dem(site: HeightField, config: OutdatedDemConfig, seed: int) -> tuple[Float32Array, GridGeometry]:
    """Elevation (H, W) float32 at the resolution of `config`, with its smooth error, shift and bias, and its geometry
    in the map frame.

    Each cell is the mean of the ground under it, as a survey grids its returns; the error's wavelengths are 60 m
    to 900 m.
    """
    g = site.geometry
    resolution = config.resolution
    size = int(g.width * g.resolution // resolution)
    geometry = GridGeometry(g.x_min, g.y_min + size * resolution, resolution, size, size)
    n = 3 if resolution > g.resolution else 1  # a cell finer than the ground has nothing to average
    fine = GridGeometry(geometry.x_min, geometry.y_max, resolution / n, size * n, size * n)
    xs, ys = HeightField(np.empty((0, 0), np.float32), fine).axes()
    east, north = config.shift
    rows = (g.y_max - (ys - north)) / g.resolution - 0.5
    cols = ((xs - east) - g.x_min) / g.resolution - 0.5
    z = ndimage.map_coordinates(
        site.elevation, np.meshgrid(rows, cols, indexing="ij"), np.float64, order=1, mode="nearest"
    )
    mean = z.reshape(size, n, size, n).mean(axis=(1, 3))
    xs, ys = HeightField(np.empty((0, 0), np.float32), geometry).axes()
    error = noise_fields.fractal(xs, ys, 900.0, seed + 601, octaves=4, gain=0.8).astype(np.float64)
    error -= error.mean()
    spread = float(error.std())
    if config.sigma > 0 and spread > 0:
        mean += error * config.sigma / spread
    mean += config.bias
    return (np.rint(mean / _QUANTUM) * _QUANTUM).astype(np.float32), geometry
