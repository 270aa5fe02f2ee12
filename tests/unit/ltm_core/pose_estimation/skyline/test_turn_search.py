import numpy as np
import pytest
from scenes.mountain_view import CAMERA, eye, terrain, view

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.mount.mount_watch import clearer_turn
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between

KNOWN = Pose.from_angles(eye(), 63.0, 2.5, 1.2)
CONFIG = PicturePoseConfig()


@pytest.mark.parametrize("turned_deg", [-1.5, 1.0, 1.75])
def test_a_turn_is_seen_on_its_side(turned_deg: float) -> None:
    true = Pose.from_angles(eye(), 63.0 + turned_deg, 2.2, 1.4)
    found = clearer(true)
    assert found is not None
    assert np.degrees(np.abs(angles_between(true, found))).max() < 0.3


def test_a_camera_that_was_not_turned_is_left_alone() -> None:
    assert clearer(Pose.from_angles(eye(), 63.1, 2.4, 1.2)) is None


def clearer(true: Pose) -> Pose | None:
    """By a picture of a camera that is believed to stand as before."""
    evidence, known = picture_evidence(*view(true), CAMERA), PosePrior(KNOWN, 1.0, 1.0, 1.0)
    assert evidence.skyline is not None
    horizon = terrain().horizon_for(CAMERA, known, CONFIG)
    return clearer_turn(evidence.skyline, CAMERA, known, horizon, CONFIG.skyline)
