"""The terrain's horizon from a place, and the contours below it."""

from __future__ import annotations

import numpy as np
import pytest
from scenes.mountain_view import BEND

from ltm_core.base.errors import PoseError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pose_estimation.skyline.terrain_horizon import terrain_horizon
from ltm_core.raster.dem import Dem
from ltm_core.tracing.possible_ground import NOTHING_BEYOND, PossibleGround


def walls(near: float = 30.0, far: float = 90.0) -> Dem:
    """Flat ground at 100 m with two walls from west to east, 400 m and 1000 m north of y = 200."""
    geometry = GridGeometry(0.0, 1500.0, 5.0, 240, 300)
    rows, cols = np.mgrid[0:300, 0:240]
    _, y = geometry.to_map(rows, cols)
    z = np.full(y.shape, 100.0)
    z[np.abs(y - 600.0) < 6] += near
    z[np.abs(y - 1200.0) < 6] += far
    return Dem(z.astype(np.float32), geometry)


def test_the_horizon_of_two_walls() -> None:
    horizon = terrain_horizon(walls(), np.array([600.0, 200.0, 110.0]), BEND, NOTHING_BEYOND, half_width=0.2)
    straight = int(np.argmin(np.abs(horizon.azimuths)))
    assert horizon.range[straight] == pytest.approx(995.0, abs=6.0)
    r = horizon.range[straight]
    assert horizon.tangent[straight] == pytest.approx(80.0 / r - BEND * r, abs=1e-4)
    # The lower wall before it is an occluding contour.
    contours = horizon.contours
    k = int(np.argmin(np.abs(contours.azimuth)))
    assert contours.range[k] == pytest.approx(395.0, abs=6.0)
    assert contours.tangent[k] == pytest.approx(20.0 / contours.range[k], abs=1e-3)
    assert contours.following[k] == k + 1
    assert not horizon.open.any()


def test_land_beyond_the_dem_leaves_the_horizon_open() -> None:
    place = np.array([600.0, 200.0, 110.0])
    low = terrain_horizon(walls(), place, BEND, PossibleGround(highest=150.0), half_width=0.2)
    high = terrain_horizon(walls(), place, BEND, PossibleGround(highest=900.0), half_width=0.2)
    assert not low.open.any(), "no higher than the wall of 190 m"
    assert high.open.all()
    assert (high.bound > high.tangent + 0.1).all()


def test_a_place_beside_the_dem_is_told() -> None:
    with pytest.raises(PoseError, match="no known terrain around"):
        terrain_horizon(walls(), np.array([90_000.0, 200.0, 110.0]), BEND)
