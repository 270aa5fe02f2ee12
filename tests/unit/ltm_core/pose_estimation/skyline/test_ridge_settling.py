from functools import cache

import numpy as np
from scenes.mountain_view import BEND, CAMERA, eye, mountains, view

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between, turned
from ltm_core.pose_estimation.skyline.pose_refinement import (
    RefinedPose,
    SkylineFit,
    settled_on_ridges,
)
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon
from ltm_core.tracing.possible_ground import PossibleGround

CONFIG = PicturePoseConfig()


TRUE = Pose.from_angles(eye(), 63.0, 2.5, 1.2)


PRIOR = PosePrior(Pose.from_angles(TRUE.position, 64.4, 2.1, 0.8), 1.5, 0.5, 0.5)


OPEN = SearchTerrain(mountains(), BEND, PossibleGround())


@cache
def seen() -> tuple[PictureEvidence, TerrainHorizon]:
    """From the true pose."""
    evidence = picture_evidence(*view(TRUE), CAMERA)
    return evidence, OPEN.horizon_for(evidence.camera, PRIOR, CONFIG)


def settled_from(pose: Pose, config: PicturePoseConfig = CONFIG) -> RefinedPose:
    evidence, horizon = seen()
    start = RefinedPose(pose, evidence.camera, np.zeros((7, 7)), -50.0, SkylineFit(support=0.7))
    return settled_on_ridges(start, PoseProblem(evidence, horizon, PRIOR, config))


def test_a_pose_a_little_aside_settles_where_the_ridges_are() -> None:
    settled = settled_from(turned(TRUE, np.radians([-0.045, 0.0, -0.15])))
    assert np.abs(np.degrees(angles_between(TRUE, settled.pose))).max() < 0.05
    assert settled.skyline == SkylineFit(support=0.7)
