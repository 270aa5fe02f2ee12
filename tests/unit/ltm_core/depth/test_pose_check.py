import numpy as np
import pytest
from scenes.depth_scene import CAMERA, SKY, TREE, depth_scene

from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.fusion_config import PoseCheckConfig
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.pose_check import check_pose
from ltm_core.vision.labels import LabelSet

CLASSES = ClassPriors.of(LabelSet.load())
SETTINGS, CONFIG = FusionSettings(), PoseCheckConfig()


def test_a_wood_along_the_skyline_is_no_wrong_pose() -> None:
    """Its tops are the photo's clearest edge, half a degree above the traced one; only the label tells that."""
    scene = depth_scene()
    land = scene.labels != SKY
    trees = round(float(np.tan(np.radians(0.5)) * CAMERA.fy))
    wooded = np.logical_or.reduce([np.roll(land, -up, axis=0) for up in range(trees + 1)])
    wooded[-trees:] = True
    labels = np.where(wooded & ~land, TREE, scene.labels)
    labels[land & np.roll(wooded & ~land, 3, axis=0)] = TREE
    photo = np.repeat(np.where(wooded, 60, 200).astype(np.uint8)[..., None], 3, axis=2)
    given = photo, scene.traced.depth(), CAMERA, SETTINGS.angle_sigma, SETTINGS.dem_sigma, CONFIG
    unlabelled = check_pose(*given)
    assert unlabelled.suspected
    assert unlabelled.pitch_deg == pytest.approx(-0.5, abs=0.15)
    assert not check_pose(*given, labels, CLASSES).suspected
