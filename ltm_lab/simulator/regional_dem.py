"""A coarse DEM of the whole region that a scene shows: the range about the site and the mountains on the horizon."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator.ground_mesh import far_radii, far_surface
from ltm_lab.simulator.terrain_synthesis import SyntheticTerrain

_REACH = 42_000.0
_CELL = 90.0


def regional_dem(terrain: SyntheticTerrain, seed: int) -> tuple[Float32Array, GridGeometry]:
    """Elevation (H, W) float32 of 90 m cells out to 42 km from the site's middle, in the map frame; whole metres, as
    global models have them."""
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
