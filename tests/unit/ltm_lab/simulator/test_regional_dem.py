"""The coarse DEM of the region is the ground that the scene's horizon is made of."""

from __future__ import annotations

import numpy as np

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_lab.simulator.ground_mesh import far_surface
from ltm_lab.simulator.regional_dem import regional_dem
from ltm_lab.simulator.terrain_synthesis import HeightField, SyntheticTerrain


def test_the_region_is_the_range_and_the_far_mountains() -> None:
    geometry = GridGeometry(-1500.0, 2500.0, 20.0, 200, 200)
    rows, cols = np.mgrid[0:200, 0:200]
    heights = (300 + 0.7 * rows + 40 * np.sin(cols / 17.0)).astype(np.float32)
    wide = HeightField(heights, geometry)
    terrain = SyntheticTerrain(HeightField(heights[:50, :50], GridGeometry(0.0, 1000.0, 20.0, 50, 50)), wide, heights)
    elevation, region = regional_dem(terrain, 77)
    assert np.isfinite(elevation).all()
    dem = Dem(elevation, region)
    x, y = np.array([-900.0, 0.0, 700.0, 2100.0]), np.array([-1200.0, 40.0, 1900.0, 300.0])
    np.testing.assert_allclose(dem.elevation_at(x, y), wide.at(x, y), atol=12.0)
    x, y, z = far_surface(wide, 77, np.array([500.0, 500.0]), 0.0)
    rings = slice(5, 70)
    inside = np.hypot(x[rings] - 500, y[rings] - 500) < 38_000
    away = np.abs(dem.elevation_at(x[rings][inside], y[rings][inside]) - z[rings][inside])
    assert np.median(away) < 4.0
    assert np.percentile(away, 95) < 40.0
    assert z[rings][inside].max() > 600, "there are mountains"
