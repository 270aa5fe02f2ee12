import json
import math

import numpy as np
import pytest
from scenes.located import CAMERA, hills, sighting

from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.locating.answer import answer, as_data, as_geojson, place_name, place_views
from ltm_core.locating.locator import Locator
from ltm_core.visibility.point_visibility import PointState, PointVisibility
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


def test_hidden_places_have_a_crest_and_a_height() -> None:
    sight = PointVisibility(hills(), curvature=False)
    tower = PosedCamera("a", CAMERA, Pose.from_angles((0.0, 0.0, 130.0), 0.0, -1.0))
    (view,) = place_views(sight, [tower], np.array([0.0, 2000.0, 0.0]), extent=100.0)
    assert view.state is PointState.HIDDEN
    # The line of sight over the crest, 30 m below the camera at half the way.
    assert view.lift == pytest.approx(130 - 30 * 2, abs=0.1)
    assert view.hidden_by == pytest.approx((0.0, 1000.0, 100.0), abs=3.0)
    assert view.distance == pytest.approx(2000.0)
    assert view.azimuth_deg == pytest.approx(0.0, abs=1e-6)
    assert view.pitch_deg == pytest.approx(-math.degrees(math.atan2(130, 2000)))
    assert view.hfov_deg == pytest.approx(math.degrees(2 * math.atan2(300, 2000)))
    assert view.pixel is not None
    assert view.pixel[0] == pytest.approx(CAMERA.cx)


def test_seen_and_outside() -> None:
    sight = PointVisibility(hills(), curvature=False)
    place = np.array([0.0, 2500.0, 80.0])
    towards = PosedCamera("a", CAMERA, Pose.from_angles((-900.0, 1300.0, 180.0), 36.0, -1.0))
    away = PosedCamera("b", CAMERA, Pose.from_angles((-900.0, 1300.0, 180.0), 216.0, -1.0))
    first, second = place_views(sight, [towards, away], place)
    assert first.state is PointState.VISIBLE
    assert first.hidden_by is None
    assert second.state is PointState.OUTSIDE
    assert second.pixel is None
    # It sees the place all the same, once it has turned.
    assert second.lift == pytest.approx(0, abs=1e-6)
    assert second.azimuth_deg == pytest.approx(first.azimuth_deg)
