import numpy as np
import pytest
from scenes.rasters import directions, rough_terrain, standing

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_lab.tracers.march import march, march_arrays

pytestmark = pytest.mark.kernel


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
