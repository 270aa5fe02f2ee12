"""Map frame, the three norths, the bent ray and the sun, against published figures; and grids."""

from __future__ import annotations

import math
from datetime import UTC, date, datetime

import numpy as np
import pytest

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.geometry.geodesy import SiteFrame, magnetic_declination_deg, ray_bend, sun_elevation
from ltm_core.geometry.grid import GridGeometry

UTM11 = SiteFrame("EPSG:32611")
LOS_ANGELES = (-118.25, 34.05)


@pytest.mark.parametrize(("km", "drop"), [(1, 0.07), (5, 1.7), (10, 6.8), (20, 27.0)])
def test_curvature_and_refraction(km: float, drop: float) -> None:
    # Surveying's combined correction (1 - k) d^2 / 2R with k = 0.13, to two figures.
    assert ray_bend(True, 0.13) * (1000 * km) ** 2 == pytest.approx(drop, rel=0.03)


def test_flat_earth_and_vacuum() -> None:
    assert ray_bend(False, 0.13) == 0.0
    assert ray_bend(True, 0.0) == pytest.approx(1 / (2 * 6_371_008.8))


@pytest.mark.parametrize("refraction", [-0.1, 1.0, float("nan")])
def test_no_refraction(refraction: float) -> None:
    with pytest.raises(ConfigError, match="refraction"):
        ray_bend(True, refraction)


def test_central_meridian() -> None:
    # On the central meridian easting is 500 km, and northing 0.9996 of the meridian's arc.
    x, y = UTM11.from_lonlat(-117.0, 34.0)
    assert float(x) == pytest.approx(500_000.0, abs=1e-3)
    assert float(y) == pytest.approx(0.9996 * _meridian_arc(34.0), abs=0.01)


def _meridian_arc(latitude_deg: float) -> float:
    """WGS 84, by integrating the meridian's radius of curvature."""
    a, e2 = 6_378_137.0, 0.00669437999014
    step = math.radians(latitude_deg) / 20_000
    middle = (np.arange(20_000) + 0.5) * step
    return float(np.sum(a * (1 - e2) / (1 - e2 * np.sin(middle) ** 2) ** 1.5) * step)


def test_origin_is_subtracted() -> None:
    frame = SiteFrame("EPSG:32611", 346_000.0, 3_783_000.0)
    x, y = UTM11.from_lonlat(-118.6, 34.2)
    near = frame.from_lonlat(-118.6, 34.2)
    assert (float(near[0]), float(near[1])) == (float(x) - 346_000, float(y) - 3_783_000)
    lon, lat = frame.to_lonlat(*near)
    assert (float(lon), float(lat)) == (pytest.approx(-118.6, abs=1e-9), pytest.approx(34.2, abs=1e-9))


@pytest.mark.parametrize("east_of_meridian", [-1.25, 0.0, 1.0])
def test_convergence_of_a_transverse_mercator(east_of_meridian: float) -> None:
    # East of the central meridian grid north lies clockwise of true north, by atan(tan(dlon) sin(lat)) on a sphere.
    x, y = (float(v) for v in UTM11.from_lonlat(-117.0 + east_of_meridian, 34.0))
    by_hand = math.degrees(math.atan(math.tan(math.radians(east_of_meridian)) * math.sin(math.radians(34.0))))
    assert UTM11.grid_convergence_deg(x, y) == pytest.approx(by_hand, abs=1e-3)


@pytest.mark.parametrize("crs", ["EPSG:32611", "EPSG:5070", "EPSG:32633"])
def test_true_north_on_the_grid(crs: str) -> None:
    frame, (lon, lat) = SiteFrame(crs, 1000.0, 2000.0), {"EPSG:32633": (13.75, 66.7)}.get(crs, LOS_ANGELES)
    x, y = frame.from_lonlat(np.array([lon, lon]), np.array([lat, lat + 1e-4]))
    walked = math.degrees(math.atan2(x[1] - x[0], y[1] - y[0])) % 360
    # Compared as a difference, since a step of 11 m from 359.99 may pass 0.
    error = frame.true_to_grid_deg(0.0, float(x[0]), float(y[0])) - walked
    assert (error + 180) % 360 - 180 == pytest.approx(0.0, abs=0.01)


def test_declination_of_los_angeles() -> None:
    in_2025 = magnetic_declination_deg(*LOS_ANGELES, date(2025, 6, 1))
    assert in_2025 == pytest.approx(11.5, abs=0.15)  # degrees east of true north
    # The pole drifts: about a tenth of a degree a year less here.
    assert magnetic_declination_deg(*LOS_ANGELES, date(2012, 6, 1)) - in_2025 == pytest.approx(1.3, abs=0.6)


def test_epochs_meet() -> None:
    before, after = (magnetic_declination_deg(*LOS_ANGELES, day) for day in (date(2024, 12, 31), date(2025, 1, 1)))
    assert before == pytest.approx(after, abs=0.1)


@pytest.mark.parametrize("day", [date(2009, 12, 31), date(2030, 1, 1)])
def test_outside_the_models_years(day: date) -> None:
    with pytest.raises(ConfigError, match=r"2010-2029.*true-north"):
        magnetic_declination_deg(*LOS_ANGELES, day)


def test_compass_to_grid() -> None:
    x, y = (float(v) for v in UTM11.from_lonlat(*LOS_ANGELES))
    day = date(2025, 6, 1)
    # Compass + declination east = true; true - convergence (grid north clockwise of true) = grid.
    expected = (355.0 + magnetic_declination_deg(*LOS_ANGELES, day) - UTM11.grid_convergence_deg(x, y)) % 360
    assert UTM11.magnetic_to_grid_deg(355.0, x, y, day) == pytest.approx(expected)
    assert expected == pytest.approx(355 + 11.45 + 0.70 - 360, abs=0.1)


@pytest.mark.parametrize(
    ("crs", "message"),
    [
        ("EPSG:4326", "WGS 84"),
        ("EPSG:4978", "projected"),
        ("EPSG:2229", "ftUS"),
        ("nonsense", "'nonsense'.*EPSG:32611"),
    ],
)
def test_no_site_frame(crs: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SiteFrame(crs)


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


GRID = GridGeometry(100.0, 500.0, 10.0, 7, 4, "EPSG:32611")


def test_edges_and_shape() -> None:
    assert GRID.shape == (4, 7)
    assert GRID.bounds == (100.0, 460.0, 170.0, 500.0)


def test_translated() -> None:
    moved = GRID.translated(-100.0, 20.0)
    assert (moved.bounds, moved.crs) == ((0.0, 480.0, 70.0, 520.0), None)
    assert GRID.translated(0.0, 0.0, crs="EPSG:5070").crs == "EPSG:5070"


def test_window() -> None:
    window = GRID.window(1, 3, 2, 4)
    assert window == GridGeometry(130.0, 490.0, 10.0, 4, 2, "EPSG:32611")
    assert [float(v) for v in window.to_map(0, 0)] == [float(v) for v in GRID.to_map(1, 3)]


def test_snapped_to_another_phase() -> None:
    assert GridGeometry.snapped((1.0, 1.0, 9.0, 4.0), 5.0, phase=2.0).bounds == (-3.0, -3.0, 12.0, 7.0)


def test_transform_maps_the_pixel_corner() -> None:
    # x = a column + b row + c, y = d column + e row + f, columns and rows counted at pixel corners.
    assert tuple(GRID.transform())[:6] == (10.0, 0.0, 100.0, 0.0, -10.0, 500.0)


@pytest.mark.parametrize(
    "values",
    [
        (float("nan"), 0.0, 1.0, 2, 2),
        (0.0, float("inf"), 1.0, 2, 2),
        (0.0, 0.0, 0.0, 2, 2),
        (0.0, 0.0, -30.0, 2, 2),
        (0.0, 0.0, 1.0, 0, 2),
        (0.0, 0.0, 1.0, 2, -1),
    ],
)
def test_no_raster(values: tuple[float, float, float, int, int]) -> None:
    with pytest.raises(RasterError, match="raster"):
        GridGeometry(*values)
