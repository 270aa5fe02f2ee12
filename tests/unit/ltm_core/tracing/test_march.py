from __future__ import annotations

import numpy as np
import pytest
from scenes.rasters import directions, rough_terrain, standing, tilted_plane

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_lab.tracers.march import march, march_arrays

pytestmark = pytest.mark.kernel


def test_depth_on_a_plain_is_the_first_step_below_it() -> None:
    plain = tilted_plane(east=0.0, north=0.0, base=100.0).dem
    ray = np.array([0.6, 0.0, -0.8])
    # 100 steps of 0.25 m go down 20 m exactly; the paper stops where the ray is no longer above the ground.
    depth = march(plain, (0.0, 0.0, 120.0), [ray], step=0.25)
    assert depth[0] == pytest.approx(100 * 0.25 * 0.6, abs=0.16)


def test_it_uses_the_nearest_cell() -> None:
    z = np.zeros((5, 40), np.float32)
    z[:, 20:] = 50.0
    wall = Dem(z, GridGeometry(0.0, 5.0, 1.0, 40, 5))
    (depth,) = march(wall, (2.5, 2.5, 10.0), [(1.0, 0.0, 0.0)], step=0.5)
    assert depth == pytest.approx(17.5)


def test_what_ends_a_ray() -> None:
    z = np.zeros((5, 40), np.float32)
    z[:, 30] = np.nan
    dem = Dem(z, GridGeometry(0.0, 5.0, 1.0, 40, 5))
    rays = [(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (np.nan, 0.0, 1.0)]
    leaves, nodata, up, down, none = march(dem, (9.3, 2.5, 10.0), rays)
    assert np.isposinf(leaves)
    assert np.isnan(nodata)
    assert np.isposinf(up)
    assert down == 0.0
    assert np.isnan(none)


def test_numpy_march_is_the_same_march() -> None:
    dem = rough_terrain(22)
    dem.elevation[40:44, 100:130] = np.nan
    position = standing(dem, 120.0, 60.0, 15.0)
    rays = directions(np.random.default_rng(22), 700)
    rays[:3] = [(0, 0, 1), (0, 0, -1), (np.nan, 0, 1)]
    np.testing.assert_allclose(march_arrays(dem, position, rays), march(dem, position, rays), rtol=1e-6)
