from __future__ import annotations

import numpy as np
import pytest
from scenes.depth_scene import CAMERA, SKY, TREE, depth_scene

from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.fusion_config import PoseCheckConfig
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.pose_check import PoseCheck, check_pose
from ltm_core.vision.labels import LabelSet

CLASSES = ClassPriors.of(LabelSet.load())
SETTINGS, CONFIG = FusionSettings(), PoseCheckConfig()


def checked(turn: float, labels: np.ndarray | None) -> PoseCheck:
    """Of a photo without any edge, so that only labels can tell."""
    scene = depth_scene()
    grey = np.full((CAMERA.height, CAMERA.width, 3), 120, np.uint8)
    traced = scene.traced if turn == 0 else scene.turned(turn)
    return check_pose(grey, traced.depth(), CAMERA, SETTINGS.angle_sigma, SETTINGS.dem_sigma, CONFIG, labels, CLASSES)


@pytest.mark.parametrize("turn", [-0.5, 0.5, 1.0, -2.0])
def test_the_skyline_tells_a_wrong_pitch(turn: float) -> None:
    check = checked(turn, depth_scene().labels)
    assert check.suspected
    assert check.checked
    assert check.columns > 0.3 * 480
    assert check.pitch_deg == pytest.approx(-turn, abs=0.2)
    assert "skyline" in check.reason


def test_an_exact_pose_is_not_suspected_even_with_rough_labels() -> None:
    labels = depth_scene().labels
    assert not checked(0.0, labels).suspected
    # Labels at a quarter of the size, and a cloud that is taken for land over a tenth of the sky.
    rough = np.repeat(np.repeat(labels[::4, ::4], 4, 0), 4, 1)
    rough[:60, 200:264] = 1
    assert not checked(0.0, rough).suspected


@pytest.mark.parametrize("cells", [24, 48, 160])
def test_labels_of_a_coarse_network_are_no_wrong_pose(cells: int) -> None:
    """Each cell's label is drawn as a block; which of two the sky's edge falls in is the network's own matter."""
    scene = depth_scene()
    grey = np.full((CAMERA.height, CAMERA.width, 3), 120, np.uint8)
    cell = CAMERA.width / cells
    rows = np.arange(CAMERA.height)
    cols = ((np.arange(CAMERA.width) // cell + 0.5) * cell).astype(int)
    for part in (0.05, 0.5, 0.95):
        at = np.minimum((rows // cell + part) * cell, CAMERA.height - 1).astype(int)
        coarse = np.ascontiguousarray(scene.labels[np.ix_(at, cols)])
        given = (coarse, CLASSES, cell)
        exact = check_pose(grey, scene.traced.depth(), CAMERA, SETTINGS.angle_sigma, SETTINGS.dem_sigma, CONFIG, *given)
        assert not exact.suspected
        # What is wrong by clearly more than half a cell is still told.
        wrong = scene.turned(-2.0).depth()
        told = check_pose(grey, wrong, CAMERA, SETTINGS.angle_sigma, SETTINGS.dem_sigma, CONFIG, *given)
        assert told.suspected or cell > 20


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
