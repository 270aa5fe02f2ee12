import math
from datetime import UTC, date, datetime

import numpy as np
import pytest
from pyproj import CRS, Transformer

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.geometry.geodesy import (
    SiteFrame,
    magnetic_declination_deg,
    map_problem,
    name_of,
    ray_bend,
    same_crs,
    scale_problem,
    sun_elevation,
)
from ltm_core.geometry.grid import GridGeometry

UTM11 = SiteFrame("EPSG:32611")
LOS_ANGELES = (-118.25, 34.05)


@pytest.mark.parametrize(("km", "drop"), [(1, 0.07), (5, 1.7), (10, 6.8), (20, 27.0)])
def test_curvature_and_refraction(km: float, drop: float) -> None:
    # Surveying's combined correction (1 - k) d^2 / 2R with k = 0.13, to two figures.
    assert ray_bend(True, 0.13) * (1000 * km) ** 2 == pytest.approx(drop, rel=0.03)


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


@pytest.mark.parametrize(("crs", "message"), [("EPSG:4978", "projected"), ("nonsense", "'nonsense'.*EPSG:32611")])
def test_no_site_frame(crs: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SiteFrame(crs)


UTM = CRS("EPSG:32611")
GK3 = "+proj=tmerc +lat_0=0 +lon_0=9 +k=1 +x_0=3500000 +y_0=0 +units=m"


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("EPSG:32611", "epsg:32611", True),
        ("EPSG:32611", "urn:ogc:def:crs:EPSG::32611", True),
        ("EPSG:32611", "+proj=utm +zone=11 +datum=WGS84 +units=m +no_defs", True),
        ("EPSG:32611", "+proj=tmerc +lon_0=-117 +k=0.9996 +x_0=500000 +datum=WGS84", True),
        ("EPSG:32611", "+proj=utm +zone=11 +ellps=WGS84 +towgs84=0,0,0 +units=m", True),
        ("EPSG:32611", UTM.to_wkt("WKT1_GDAL"), True),
        ("EPSG:32611", UTM.to_wkt("WKT1_ESRI"), True),
        ("EPSG:32611", UTM.to_wkt(), True),
        ("EPSG:32611", UTM.to_json(), True),
        ("EPSG:32611", UTM.to_wkt("WKT1_GDAL").replace('UNIT["metre"', 'UNIT["METERS"'), True),
        ("EPSG:32611", "EPSG:32611+5703", True),
        ("EPSG:25832", "+proj=utm +zone=32 +ellps=GRS80 +towgs84=0,0,0,0,0,0,0 +units=m", True),
        ("EPSG:31467", f"{GK3} +datum=potsdam", True),
        ("EPSG:31467", f"{GK3} +ellps=bessel +towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7", True),
        ("EPSG:31467", f"{GK3} +ellps=GRS80", False),  # the same projection of another ellipsoid: 100 m off
        ("EPSG:32611", "EPSG:32612", False),
        ("EPSG:32611", "EPSG:26911", False),  # NAD83: 1.5 m off
        ("EPSG:32611", "EPSG:4326", False),
        ("EPSG:32611", "+proj=utm +zone=11 +datum=WGS84 +units=us-ft", False),
        ("EPSG:3857", "ESRI:102100", True),
        ("EPSG:5070", "ESRI:102039", True),
        ("EPSG:5070", "EPSG:6350", False),
    ],
)
def test_crss_are_compared_by_what_they_mean(one: str, other: str, same: bool) -> None:
    assert same_crs(one, other) is same
    assert same_crs(other, one) is same


def test_a_code_is_named_only_if_it_is_the_crs() -> None:
    for text in ("WKT1_GDAL", "WKT1_ESRI", "WKT2_2019"):
        assert name_of(CRS(UTM.to_wkt(text))) == "EPSG:32611"
    unknown = "+proj=utm +zone=11 +ellps=WGS84 +units=m"
    assert CRS(unknown).to_authority() == ("EPSG", "32611")  # PROJ guesses
    assert not name_of(CRS(unknown)).startswith("EPSG")


@pytest.mark.parametrize(
    ("crs", "problem"),
    [
        *((name, None) for name in ("EPSG:32611", "EPSG:2180", "EPSG:31467", "EPSG:5514", "EPSG:3031", "EPSG:3413")),
        *((name, "south and west") for name in ("EPSG:2048", "EPSG:2053", "EPSG:5513")),
        *((name, "in metres") for name in ("EPSG:2229", "EPSG:4326", "+proj=utm +zone=11 +units=km")),
        (UTM.to_3d(), "ellipsoid"),
        ("EPSG:32611+5703", None),
    ],
)
def test_what_a_map_needs(crs: str, problem: str | None) -> None:
    found = map_problem(CRS(crs))
    assert found is None if problem is None else problem in (found or "")


@pytest.mark.parametrize(
    ("crs", "lon", "lat", "suitable"),
    [
        *((name, -118.2, 34.0, None) for name in ("EPSG:32611", "EPSG:26911", "EPSG:26945", "EPSG:6424")),
        *((name, -118.2, 34.0, "EPSG:32611") for name in ("EPSG:3857", "EPSG:32602", "EPSG:5070", "ESRI:54009")),
        ("EPSG:3395", -118.2, 34.0, "EPSG:32611"),
        ("EPSG:6933", -118.2, 34.0, "EPSG:32611"),
        *((name, lon, lat, None) for name, lon, lat in (("EPSG:2154", 3.0, 45.0), ("EPSG:2193", 172.0, -43.0))),
        *((name, lon, lat, None) for name, lon, lat in (("EPSG:27700", -3.0, 55.0), ("EPSG:2056", 8.0, 46.5))),
        *((name, lon, lat, None) for name, lon, lat in (("EPSG:5514", 15.0, 50.0), ("EPSG:3763", -8.0, 39.5))),
        ("EPSG:3035", -5.0, 40.0, "EPSG:32630"),
        ("EPSG:3577", 146.0, -37.0, "EPSG:32755"),
        ("EPSG:32611", -111.0, 34.0, "EPSG:32612"),  # a zone's width beside its meridian
    ],
)
def test_maps_that_distort_distances(crs: str, lon: float, lat: float, suitable: str | None) -> None:
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    problem = scale_problem(crs, GridGeometry(x - 500, y + 500, 100.0, 10, 10))
    assert problem is None if suitable is None else suitable in (problem or "")


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


@pytest.mark.parametrize(
    "values", [(math.nan, 0.0, 1.0, 2, 2), (0.0, math.inf, 1.0, 2, 2), (0.0, 0.0, -30.0, 2, 2), (0.0, 0.0, 1.0, 2, 0)]
)
def test_no_raster(values: tuple[float, float, float, int, int]) -> None:
    with pytest.raises(RasterError, match="raster"):
        GridGeometry(*values)
