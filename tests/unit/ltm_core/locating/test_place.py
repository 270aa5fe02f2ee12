"""The way back: places in pictures, what hides them, where to turn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes.located import CAMERA, hills

from ltm_core.base.errors import RegionError
from ltm_core.geometry.pose import Pose
from ltm_core.locating.answer import place_views
from ltm_core.visibility.point_visibility import PointState, PointVisibility
from ltm_core.visibility.viewshed import PosedCamera

pytestmark = pytest.mark.kernel


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
    assert first.seen
    assert first.hidden_by is None
    assert second.state is PointState.OUTSIDE
    assert second.pixel is None
    # It sees the place all the same, once it has turned.
    assert second.lift == pytest.approx(0, abs=1e-6)
    assert second.azimuth_deg == pytest.approx(first.azimuth_deg)


def test_a_place_without_a_height_is_told() -> None:
    sight = PointVisibility(hills(), curvature=False)
    with pytest.raises(RegionError, match="finite coordinates"):
        place_views(sight, [], np.array([0.0, 9000.0, np.nan]))
