"""Poses of the fuel map's trials, found in the pictures that are drawn for them."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.base.errors import PoseError
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.raster.dem import Dem
from ltm_core.vision.labels import Label
from ltm_lab.evaluation.fuel.trial_country import CAMERA, World, make_world, tower_views
from ltm_lab.evaluation.fuel.trial_pictures import TrialPictures


@pytest.mark.slow
def test_a_believed_pose_becomes_the_true_one_and_fog_leaves_it() -> None:
    world = make_world(6, 0.05)
    pictures = TrialPictures(world, ray_bend(True, 0.13), np.random.default_rng(3), world.towers)
    _, position, azimuth, pitch = tower_views(world.towers)[1]
    believed = Pose.from_angles(position, azimuth, pitch)
    true = Pose.from_angles(position, azimuth + 0.9, pitch - 0.6, 0.5)
    land = np.full((CAMERA.height, CAMERA.width), np.uint8(LifeForm.SHRUB))
    found, covariance = pictures.refined(believed, true, 0.6, land)
    assert np.degrees(np.abs(angles_between(true, found))).max() < 0.25
    assert np.degrees(np.sqrt(covariance.diagonal()[3:])).max() < 0.3
    far_off = Pose.from_angles(position, azimuth, pitch - 70.0)  # looks at its feet
    found, covariance = pictures.refined(far_off, far_off, 0.6, np.full_like(land, np.uint8(Label.BARE)))
    np.testing.assert_allclose(found.rotation, far_off.rotation, atol=1e-12)
    np.testing.assert_allclose(covariance, PosePrior(far_off, 0.6, 0.6, 0.6).covariance)


def test_a_low_camera_in_a_wood_stands_in_no_tree() -> None:
    ground = GridGeometry(0.0, 1200.0, 10.0, 90, 120)
    rows, cols = np.indices(ground.shape)
    dem = Dem((300 + 20 * np.sin(rows / 9) + 25 * np.cos(cols / 7)).astype(np.float32), ground)
    cells = GridGeometry(0.0, 1200.0, 30.0, 30, 40)
    wood = np.full(cells.shape, LifeForm.TREE, np.uint8)
    prior = FuelPrior(np.full(cells.shape, 183, np.int16), cells)
    fine = np.full((120, 90), LifeForm.TREE, np.uint8)
    world = World(dem, cells, fine, wood, np.zeros(cells.shape, bool), prior, ())
    place = (430.0, 610.0, float(dem.elevation_at(430.0, 610.0)) + 2.0)
    pose = Pose.from_angles(place, 60.0, -4.0)
    land = np.full((CAMERA.height, CAMERA.width), np.uint8(LifeForm.TREE))
    with pytest.raises(PoseError, match="under the ground"):
        TrialPictures(world, 0.0, np.random.default_rng(3), []).refined(pose, pose, 0.6, land)
    _, covariance = TrialPictures(world, 0.0, np.random.default_rng(3), [place]).refined(pose, pose, 0.6, land)
    assert 0 < np.degrees(np.sqrt(covariance.diagonal()[3:])).max() < 0.61
