"""How likely a picture is by the angle that its camera is turned by."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes.mountain_view import CAMERA, eye, terrain, view

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.mount.mount_watch import skyline_turns
from ltm_core.pose_estimation.mount.skyline_turns import SKYLINE_TURNS, SkylineTurns
from ltm_core.pose_estimation.skyline.picture_evidence import picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.vision.labels import UNLABELLED

pytestmark = pytest.mark.kernel

STATED = Pose.from_angles(eye(), 63.0, 2.5, 1.2)
CONFIG = PicturePoseConfig()


def said(true: Pose, fog: bool = False) -> SkylineTurns | None:
    photo, labels = view(true)
    if fog:
        photo, labels = np.full_like(photo, 200), np.full_like(labels, UNLABELLED)
    prior = PosePrior(STATED, 1.0, 1.0, 1.0)
    horizon = terrain().horizon_for(CAMERA, prior, CONFIG)
    return skyline_turns(picture_evidence(photo, labels, CAMERA), 7, prior, horizon, CONFIG)


@pytest.mark.parametrize("too_great_deg", [-2.0, 0.0, 1.3, 4.0])
def test_it_is_likeliest_at_the_turn(too_great_deg: float) -> None:
    """Stated over true, as locating counts it; the camera leans a little more than is stated, too."""
    found = said(Pose.from_angles(eye(), 63.0 - too_great_deg, 2.3, 1.4))
    assert found is not None
    assert math.degrees(SKYLINE_TURNS[int(found.logs.argmax())]) == pytest.approx(too_great_deg, abs=0.15)
    elsewhere = np.abs(SKYLINE_TURNS - math.radians(too_great_deg)) > math.radians(1.0)
    assert found.logs[elsewhere].max() < found.logs.max() - 5
    assert (found.stamp_ns, found.azimuth) == (7, pytest.approx(math.radians(63.0)))
    assert math.degrees(found.hfov) == pytest.approx(52.0)


def test_fog_says_nothing() -> None:
    assert said(STATED, fog=True) is None
