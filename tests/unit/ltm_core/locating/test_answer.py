"""What is said of a location: coordinates, fuel, JSON and GeoJSON."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scenes.located import CAMERA, hills, sighting

from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.locating.answer import answer, as_data, as_geojson, place_name
from ltm_core.locating.locator import Locator
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_core.visibility.viewshed import PosedCamera

pytestmark = pytest.mark.kernel

FRAME = SiteFrame("EPSG:32611", 400_000.0, 3_800_000.0)


def test_mgrs_of_a_place_that_others_have_worked_out() -> None:
    frame = SiteFrame("EPSG:32615")
    x, y = (float(v) for v in frame.from_lonlat(-93.0, 42.0))
    name = place_name(frame, x, y, 300.0)
    assert name.mgrs == "15T WG 00000 49776"  # the example of the library's page
    assert (name.lon, name.lat) == pytest.approx((-93.0, 42.0))
    assert place_name(SiteFrame("EPSG:32615", 0.0, 5e6), 5e5, 4.4e6, 0.0).mgrs is None  # 84.7 degrees north


def test_mgrs_and_utm_say_the_same() -> None:
    name = place_name(FRAME, 123.4, 5678.9, 12.0)
    assert name.mgrs is not None
    _, _, easting, northing = name.mgrs.split()
    assert (int(easting), int(northing)) == (int(name.x) % 100_000, int(name.y) % 100_000)


def test_an_answer_says_it_all() -> None:
    dem = hills()
    place = np.array([-100.0, 2500.0, 80.0])
    tower = sighting("north", (-900.0, 1300.0, 180.0), place)
    location = Locator(dem, 0.0).locate([tower])
    cameras = [
        PosedCamera("north", CAMERA, tower.pose),
        PosedCamera("far", CAMERA, sighting("far", (0.0, 0.0, 130.0), np.array([0.0, 2000.0, 0.0])).pose),
    ]
    codes = np.full((46, 31), 102, np.int16)
    prior = FuelPrior(codes, GridGeometry(-1500.0, 4000.0, 100.0, 31, 46))
    said = answer(location, PointVisibility(dem, False), FRAME, cameras, prior, smoke=False)
    data = json.loads(json.dumps(as_data(said, FRAME), allow_nan=False))
    assert data["place"]["x"] == pytest.approx(400_000 - 100, abs=20)
    assert data["place"]["elevation"] == pytest.approx(80, abs=10)
    assert data["elevation_sigma"] > 0
    assert data["fuel"] == {"code": 102, "name": "GR2"}
    assert [e["share"] for e in data["ellipses"]] == [0.5, 0.95]
    assert data["ellipses"][0]["semi_major"] < data["ellipses"][1]["semi_major"]
    north, far = data["cameras"]
    assert north["state"] == "visible"
    assert north["distance"] == pytest.approx(np.hypot(800, 1200), abs=20)
    assert far["state"] in ("visible", "hidden")
    assert data["agreement"] is None

    collection = json.loads(json.dumps(as_geojson(said, FRAME, {"track": 3}), allow_nan=False))
    point, *others = collection["features"]
    assert point["properties"]["track"] == 3
    assert point["geometry"]["coordinates"] == pytest.approx([data["place"]["lon"], data["place"]["lat"]], abs=1e-6)
    rings = [feature["geometry"]["coordinates"][0] for feature in others if feature["geometry"]["type"] == "Polygon"]
    assert len(rings) == 2
    for ring in rings:
        assert ring[0] == ring[-1]
        x, y = np.array(ring).T
        assert (x[:-1] * y[1:] - x[1:] * y[:-1]).sum() > 0  # counter-clockwise, as RFC 7946 asks for


def test_beside_the_prior_no_fuel_is_known() -> None:
    dem = hills()
    location = Locator(dem, 0.0).locate([sighting("a", (-900.0, 1300.0, 180.0), np.array([-100.0, 2500.0, 80.0]))])
    prior = FuelPrior(np.full((2, 3), 102, np.int16), GridGeometry(5000.0, 4000.0, 100.0, 3, 2))
    assert answer(location, PointVisibility(dem, False), FRAME, [], prior, False).fuel is None
    assert answer(location, PointVisibility(dem, False), FRAME, [], None, False).fuel is None
