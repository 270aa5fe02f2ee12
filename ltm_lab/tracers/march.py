"""Algorithm 1 of the LTM paper exactly as printed: the baseline of benchmarks.

    x, y, z = X_cam, Y_cam, Cam_elev
    while DEM[x][y] < z:  x += dX(ray);  y += dY(ray);  z += d_elev(ray)
    depth[u][v] = |(x, y) - (X_cam, Y_cam)|;  img-DEM[u][v] = (x, y)

The nearest cell at fixed steps along the ray, on a flat earth. A ray also ends where it leaves the raster (the paper
does not say) and at nodata. Its range is off by up to a step and by half a cell, and it can step through a crest: use
`TerrainTracer` for anything but comparison.
"""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.raster.dem import Dem


def march(dem: Dem, origin: ArrayLike, directions: ArrayLike, step: float = 1.0) -> Float32Array:
    """The paper's depth, horizontal metres, of each ray, (N,) float32; +inf where it leaves the raster, NaN at nodata.

    Args:
        origin: (3,) x, y, z in the DEM's frame; height from the barometer, or ground plus the tripod's.
        directions: (N, 3) unit vectors, x, y, z.
        step: metres along the ray.

    Raises PoseError for an origin or step that cannot be marched from.
    """
    start = np.array(origin, np.float64)
    if start.shape != (3,) or not np.isfinite(start).all() or not step > 0:
        raise PoseError(
            f"cannot march from {start.tolist()} at steps of {step} m: needs finite x, y, z and a step above 0"
        )
    rays = np.ascontiguousarray(directions, np.float64)
    depth = np.empty(len(rays), dtype=np.float32)
    geometry = dem.geometry
    _march(dem.elevation, geometry.x_min, geometry.y_max, geometry.resolution, start, rays, step, depth)
    return depth


def march_arrays(dem: Dem, origin: ArrayLike, directions: ArrayLike, step: float = 1.0) -> Float32Array:
    """The same march in plain NumPy, all rays a step at a time: what the paper's algorithm costs without a compiler."""
    start = np.asarray(origin, np.float64)
    rays = np.asarray(directions, np.float64)
    depth = np.full(len(rays), np.nan, np.float32)
    level = np.abs(rays[:, :2]).sum(axis=1) <= 1e-12
    depth[level & (rays[:, 2] >= 0)] = np.inf
    under_way = np.flatnonzero(np.isfinite(rays).all(axis=1) & ~(level & (rays[:, 2] >= 0)))
    position = np.broadcast_to(start, (under_way.size, 3)).copy()
    geometry, elevation = dem.geometry, dem.elevation
    while under_way.size:
        row, col = geometry.cell_of(position[:, 0], position[:, 1])
        inside = (row >= 0) & (row < geometry.height) & (col >= 0) & (col < geometry.width)
        ground = elevation[np.where(inside, row, 0), np.where(inside, col, 0)]
        met = inside & (ground >= position[:, 2])
        depth[under_way[~inside]] = np.inf
        depth[under_way[met]] = np.hypot(*(position[met, :2] - start[:2]).T)
        on = inside & (ground < position[:, 2])
        under_way, position = under_way[on], position[on]
        position += rays[under_way] * step
    return depth


@njit(cache=True, parallel=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _march(
    elevation: Float32Array,
    x_min: float,
    y_max: float,
    resolution: float,
    start: Float64Array,
    rays: Float64Array,
    step: float,
    depth: Float32Array,
) -> None:
    n_rows, n_cols = elevation.shape
    for k in prange(rays.shape[0]):
        dx, dy, dz = rays[k, 0] * step, rays[k, 1] * step, rays[k, 2] * step
        x, y, z = start[0], start[1], start[2]
        depth[k] = np.nan
        if not (dx == dx and dy == dy and dz == dz):
            continue
        # A ray straight up would never leave the raster sideways.
        while abs(dx) + abs(dy) > 1e-12 * step or dz < 0.0:
            col = math.floor((x - x_min) / resolution)
            row = math.floor((y_max - y) / resolution)
            if row < 0 or row >= n_rows or col < 0 or col >= n_cols:
                depth[k] = np.inf
                break
            ground = elevation[int(row), int(col)]
            if ground != ground:
                break
            if not ground < z:
                depth[k] = math.hypot(x - start[0], y - start[1])
                break
            x += dx
            y += dy
            z += dz
        else:
            depth[k] = np.inf
