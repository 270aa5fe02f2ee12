from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scenes.mountain_view import BEND, CAMERA, eye, mountains, view

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline import pose_refinement as ridge_settling
from ltm_core.pose_estimation.skyline.contour_scores import ContourDirections
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.picture_evidence import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig, SettlingConfig
from ltm_core.pose_estimation.skyline.pose_observations import RidgeObservations
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between, turned
from ltm_core.pose_estimation.skyline.pose_refinement import (
    RefinedPose,
    SkylineFit,
    ridge_system,
    settled_on_ridges,
    shared_covariance,
)
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon
from ltm_core.tracing.possible_ground import PossibleGround

CONFIG = PicturePoseConfig()
TRUE = Pose.from_angles(eye(), 63.0, 2.5, 1.2)
PRIOR = PosePrior(Pose.from_angles(TRUE.position, 64.4, 2.1, 0.8), 1.5, 0.5, 0.5)
OPEN = SearchTerrain(mountains(), BEND, PossibleGround())


def places(ground: Float64Array, error: Float64Array, shared: float = 3.0, own: float = 2.0) -> RidgeObservations:
    """Of ridges that a turn about the map's z moves by 100 px a radian."""
    n = len(ground)
    slopes = np.zeros((n, 7))
    slopes[:, 5] = 100.0
    one = np.ones(n)
    return RidgeObservations(error, slopes, np.hypot(shared, own) * one, one, shared * one, ground)


def test_what_places_share_falls_with_their_distance() -> None:
    config = SettlingConfig(share=0.6, stand=150.0, plant=5.0)
    rows = places(np.array([[0.0, 0.0], [90.0, 120.0], [3.0, 4.0]]), np.zeros(3))
    covariance = shared_covariance(rows, np.array([1.0, 0.5, 1.0]), config)
    assert covariance[0, 0] == pytest.approx(9.0 + 4.0)
    assert covariance[1, 1] == pytest.approx(9.0 + 4.0 + 13.0), "half of it is something else"
    assert covariance[0, 1] == pytest.approx(9.0 * 0.6 * np.exp(-1.0), rel=1e-3)
    assert covariance[2, 0] == pytest.approx(9.0 * (0.6 * np.exp(-5 / 150) + 0.4 * np.exp(-1.0)))


@cache
def seen() -> tuple[PictureEvidence, TerrainHorizon]:
    """From the true pose."""
    evidence = picture_evidence(*view(TRUE), CAMERA)
    return evidence, OPEN.horizon_for(evidence.camera, PRIOR, CONFIG)


def system_of(rows: RidgeObservations | None, monkeypatch: pytest.MonkeyPatch) -> tuple[Float64Array, Float64Array]:
    """Of these places, which all fit."""
    evidence, horizon = seen()
    ridges = ContourDirections.of(horizon, CONFIG.contours.nearest)
    monkeypatch.setattr(ridge_settling, "ridge_observations", lambda *given: rows)
    monkeypatch.setattr(ridge_settling, "fitting", lambda rows, *given: np.ones(len(rows.error)))
    return ridge_system(TRUE, CAMERA, evidence, horizon, ridges, 3.0, 1.0, CONFIG)


def settled_from(pose: Pose, config: PicturePoseConfig = CONFIG) -> RefinedPose:
    evidence, horizon = seen()
    start = RefinedPose(pose, evidence.camera, np.zeros((7, 7)), -50.0, SkylineFit(support=0.7))
    return settled_on_ridges(start, evidence, horizon, PRIOR, 0.0, config)


def test_the_places_of_one_stand_count_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two stands, of 30 places and of three: what grows in each is one unknown."""
    ground = np.repeat([[0.0, 0.0], [0.0, 9000.0]], [30, 3], axis=0)
    rows = places(ground, np.repeat([0.4, -0.4], [30, 3]))
    normal, gradient = system_of(rows, monkeypatch)
    many, few = 1 / (9 + 4 / 30), 1 / (9 + 4 / 3)
    assert normal[5, 5] == pytest.approx(100.0**2 * (many + few), rel=1e-6)
    assert gradient[5] == pytest.approx(100.0 * 0.4 * (many - few), rel=1e-6)


def test_a_pose_a_little_aside_settles_where_the_ridges_are() -> None:
    settled = settled_from(turned(TRUE, np.radians([-0.045, 0.0, -0.15])))
    assert np.abs(np.degrees(angles_between(TRUE, settled.pose))).max() < 0.05
    assert settled.skyline == SkylineFit(support=0.7)


def test_without_ridges_the_stated_pose_stays() -> None:
    none = CONFIG.model_copy(update={"contours": CONFIG.contours.model_copy(update={"nearest": 1e6})})
    away = np.degrees(np.abs(angles_between(PRIOR.pose, settled_from(TRUE, none).pose)))
    assert away.max() < 0.01
