"""What must hold for any terrain: the fan's lines of sight are those of `PointVisibility`; turning and moving the world
turns and moves the answer; what more is not known, the answer does not know either.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes.located import sighting
from scenes.rasters import rough_terrain

from ltm_core.geometry.geodesy import ray_bend
from ltm_core.geometry.grid import GridGeometry
from ltm_core.locating.directions import direction_table, marked_directions, sight_likelihood
from ltm_core.locating.locator import Locator
from ltm_core.locating.sight_fan import sight_fan
from ltm_core.raster.dem import Dem
from ltm_core.visibility.point_visibility import PointVisibility

pytestmark = pytest.mark.kernel

DEM = rough_terrain(5, (181, 263), resolution=10.0, relief=300.0)
BEND = ray_bend(True, 0.13)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.floats(0.15, 0.85), st.floats(0.15, 0.85), st.floats(3.0, 40.0), st.floats(-3.0, 3.0))
def test_a_fans_lifts_are_those_of_exact_lines_of_sight(
    across: float, down: float, mast: float, azimuth: float
) -> None:
    g = DEM.geometry
    x, y = g.x_min + across * (g.x_max - g.x_min), g.y_min + down * (g.y_max - g.y_min)
    position = np.array([x, y, float(DEM.elevation_at(x, y)) + mast])
    target = position + np.array([np.sin(azimuth), np.cos(azimuth), 0.0]) * 100
    mark = sighting("a", tuple(position), target)
    azimuths = np.linspace(azimuth - 0.02, azimuth + 0.02, 5)
    fan = sight_fan(DEM, position, azimuths, 3000.0)
    directions = marked_directions(mark.mark, mark.camera, mark.pose, mark.covariance, 0.0)
    table = direction_table(directions, azimuths, True)
    exact_heights, apart = np.zeros(1), np.array([40.0])
    lifts = sight_likelihood(fan, table, float(position[2]), BEND, exact_heights, apart, True).lifts
    r = fan.ranges
    for a in (0, 3):
        known = np.isfinite(fan.heights[a])
        places = np.column_stack(
            [x + np.sin(azimuths[a]) * r, y + np.cos(azimuths[a]) * r, fan.heights[a].astype(np.float64)]
        )[known]
        exact, _ = PointVisibility(DEM).lifts(position, places)
        off = np.abs(lifts[a][known] - np.maximum(exact, 0))
        # A crest between two samples, half a metre apart or three thousandths of the range, stands a little higher.
        assert np.quantile(off, 0.9) < 0.3 + 0.003 * r[known].max()


@settings(max_examples=6, deadline=None, derandomize=True)
@given(st.integers(-3, 3), st.integers(-3, 3))
def test_moving_the_world_moves_the_answer(east: int, north: int) -> None:
    shift = np.array([east * 1024.0, north * 1024.0, 0.0])
    place, tower, g = np.array([1400.0, -500.0, 0.0]), np.array([700.0, -1300.0, 0.0]), DEM.geometry
    place[2] = float(DEM.elevation_at(*place[:2]))
    tower[2] = float(DEM.elevation_at(*tower[:2])) + 60.0
    moved = Dem(DEM.elevation, GridGeometry(g.x_min + shift[0], g.y_max + shift[1], g.resolution, g.width, g.height))
    here = Locator(DEM, 0.0).locate([sighting("a", tuple(tower), place)], smoke=True).posterior
    there = Locator(moved, 0.0).locate([sighting("a", tuple(tower + shift), place + shift)], smoke=True).posterior
    assert np.array(there.mean) - shift[:2] == pytest.approx(np.array(here.mean), abs=1.5)
    assert there.covariance == pytest.approx(here.covariance, rel=0.1, abs=1.0)
