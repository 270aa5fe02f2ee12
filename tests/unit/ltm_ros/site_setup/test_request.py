"""Areas on the Earth, against PROJ's geodesics."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import Geod

from ltm_core.base.errors import ConfigError
from ltm_ros.site_setup.request import Area


@pytest.mark.parametrize("lat", [-60.0, -33.0, 0.0, 34.09, 64.8])
@pytest.mark.parametrize("radius", [500.0, 8000.0, 40_000.0])
def test_an_area_contains_the_circle_and_little_more(lat: float, radius: float) -> None:
    area = Area.around(-118.47, lat, radius)
    west, south, east, north = area.bounds_lonlat
    azimuths = np.arange(0.0, 360.0, 15.0)
    lon, lats, _ = Geod(ellps="WGS84").fwd(np.full(24, -118.47), np.full(24, lat), azimuths, np.full(24, radius))
    assert west <= min(lon) <= max(lon) <= east
    assert south <= min(lats) <= max(lats) <= north
    assert area.size_m == pytest.approx((2 * radius, 2 * radius), rel=0.04)


@pytest.mark.parametrize(
    "place", [(179.99, 52.0, 8000.0), (10.0, 89.99, 8000.0), (10.0, 91.0, 10.0), (0.0, 0.0, 0.0), (0.0, 0.0, np.nan)]
)
def test_areas_that_cannot_be_are_errors(place: tuple[float, float, float]) -> None:
    with pytest.raises(ConfigError):
        Area.around(*place)
