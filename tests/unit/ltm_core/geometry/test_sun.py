"""The sun's elevation against what is known of it."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from ltm_core.geometry.geodesy import sun_elevation


def degrees(latitude: float, longitude: float, moment: str) -> float:
    stamp = datetime.fromisoformat(moment).replace(tzinfo=UTC).timestamp() * 1e9
    return float(np.degrees(sun_elevation(np.radians(latitude), np.radians(longitude), stamp)))


@pytest.mark.parametrize(
    ("latitude", "longitude", "moment", "expected"),
    [
        (23.437, 0.0, "2024-06-21T12:02", 90.0),  # the solstice on the tropic; the equation of time is -1.8 min
        (-23.437, 90.0, "2023-12-22T05:58", 90.0),
        (0.0, 0.0, "2024-03-20T12:07", 90.0),  # the equinox on the equator
        (90.0, 0.0, "2024-06-20T20:51", 23.44),  # the pole sees the tilt of the axis, at every hour
        (90.0, 0.0, "2024-12-21T09:20", -23.44),
        (0.0, 180.0, "2024-03-20T12:07", -90.0),
        (34.2, -118.1, "2024-09-22T19:44", 55.8),  # an equinox noon: 90 degrees less the latitude
    ],
)
def test_elevation(latitude: float, longitude: float, moment: str, expected: float) -> None:
    assert degrees(latitude, longitude, moment) == pytest.approx(expected, abs=0.3)


def test_many_stamps_keep_their_shape() -> None:
    stamps = np.arange(6).reshape(2, 3) * 3600 * 10**9
    assert sun_elevation(0.6, -2.0, stamps).shape == (2, 3)
