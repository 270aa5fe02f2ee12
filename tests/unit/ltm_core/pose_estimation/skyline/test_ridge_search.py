import numpy as np
from scenes.mountain_view import CAMERA, OPEN, PRIOR, TRUE, view

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_config import Criteria
from ltm_core.pose_estimation.skyline.pose_hypothesis import Hypothesis
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem
from ltm_core.pose_estimation.skyline.pose_prior import angles_between, turned
from ltm_core.pose_estimation.skyline.pose_refinement import RefinedPose, SkylineFit, settled_on_ridges
from ltm_core.pose_estimation.skyline.pose_search import search_ridges
from ltm_core.vision.labels import Label


def problem_of(picture: tuple[UInt8Array, UInt8Array]) -> PoseProblem:
    evidence = picture_evidence(*picture, CAMERA)
    return PoseProblem(evidence, OPEN.horizon_for(evidence.camera, PRIOR), PRIOR)


def best_of(picture: tuple[UInt8Array, UInt8Array]) -> Hypothesis:
    return search_ridges(problem_of(picture))[0]


def off_deg(hypothesis: Hypothesis) -> np.ndarray:
    return np.degrees(np.abs(angles_between(TRUE, hypothesis.refined.pose)))


def test_a_crest_against_the_sky_is_laid_on_its_own_edge_and_not_on_what_is_below() -> None:
    photo, labels = view(TRUE)
    for u in range(CAMERA.width):  # a pale band along the crest: its lower margin is an edge as long
        top = int(np.argmax(labels[:, u] != Label.SKY))
        photo[top : top + 5, u] = np.minimum(photo[top : top + 5, u].astype(int) + 25, 255)
    found = best_of((photo, labels))
    assert off_deg(found)[:2].max() < 0.1
    assert found.ridge_score > Criteria.plants_score


def test_among_plants_crests_stand_over_the_dem_by_what_labels_say() -> None:
    x, y, z = TRUE.position
    photo, bare = view(Pose.from_angles((x, y, z - 3.0), 63.0, 2.5, 1.2))  # as if all the land stood 3 m higher
    wooded = np.where(bare == Label.SKY, bare, np.uint8(Label.TREE)).astype(np.uint8)
    by_trees, by_ground = off_deg(best_of((photo, wooded)))[1], off_deg(best_of((photo, bare)))[1]
    assert by_trees < 0.1
    assert by_ground > 0.15


def test_a_pose_a_little_aside_settles_where_the_ridges_are() -> None:
    pose = turned(TRUE, np.radians([-0.045, 0.0, -0.15]))
    start = RefinedPose(pose, CAMERA, np.zeros((7, 7)), -50.0, SkylineFit(support=0.7))
    settled = settled_on_ridges(start, problem_of(view(TRUE)))
    assert np.abs(np.degrees(angles_between(TRUE, settled.pose))).max() < 0.05
    assert settled.skyline == SkylineFit(support=0.7)
