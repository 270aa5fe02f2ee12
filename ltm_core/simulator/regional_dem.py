"""A coarse DEM of the whole region that a scene shows: the range about the site and the mountains on the horizon."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from ltm_core.grid import GridGeometry
from ltm_core.simulator.ground_mesh import far_surface
from ltm_core.simulator.terrain_synthesis import SyntheticTerrain
from ltm_core.types import Float32Array

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
    x, y, z = (values[:, :-1].ravel() for values in far_surface(wide, seed, middle, 0.0))
    columns, rows = np.meshgrid(np.arange(size), np.arange(size))
    east, north = geometry.to_map(rows, columns)
    elevation = LinearNDInterpolator(np.column_stack([x, y]), z)(east, north)
    near = (east > g.x_min) & (east < g.x_max) & (north > g.y_min) & (north < g.y_max)
    elevation[near] = wide.at(east[near], north[near])
    return np.asarray(np.rint(elevation), np.float32), geometry
