from dataclasses import replace

import numpy as np
import pytest
from scenes.mountain_view import CAMERA, eye, terrain, view

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, find_pose
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem, skyline_observations
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior

TRUE = Pose.from_angles(eye(), 63.0, 2.5, 1.2)
PRIOR = PosePrior(Pose.from_angles(TRUE.position, 63.4, 2.3, 1.0), 1.5, 0.6, 0.6)


@pytest.fixture(scope="module")
def exact() -> PictureEvidence:
    return picture_evidence(*view(TRUE), CAMERA)


def uneven(evidence: PictureEvidence, sigmas: float) -> PictureEvidence:
    """Every other column of its skyline is too high, the rest too low, by so many of their sigmas at the true pose."""
    horizon = terrain().horizon_for(evidence.camera, PRIOR, PicturePoseConfig())
    rows = skyline_observations(TRUE, evidence.camera, PoseProblem(evidence, horizon, PRIOR, PicturePoseConfig()), 1.0)
    assert rows is not None
    assert evidence.skyline is not None
    v = evidence.skyline.v + sigmas * np.where(np.arange(len(rows.sigma)) % 2, 1.0, -1.0) * rows.sigma
    return replace(evidence, skyline=replace(evidence.skyline, v=v))


def sigmas(search: PictureSearch) -> Float64Array:
    return np.asarray(np.sqrt(np.diag(search.hypotheses[0].refined.covariance)[3:6]), np.float64)


def test_misfits_of_the_stated_size_change_nothing_and_twice_as_large_ones_make_a_pose_less_sure(
    exact: PictureEvidence,
) -> None:
    found = {size: find_pose(uneven(exact, size), terrain(), PRIOR) for size in (0.0, 1.0, 2.0)}
    variance = {size: search.hypotheses[0].refined.skyline.variance for size, search in found.items()}
    assert variance[0.0] < 0.5
    assert variance[1.0] == pytest.approx(1.0, abs=0.25)
    assert 2.0 < variance[2.0] < 4.0  # the square of 2, and two places of what is stated beside
    assert (sigmas(found[0.0]) < sigmas(found[1.0])).all()
    assert (sigmas(found[2.0]) > 1.2 * sigmas(found[1.0])).all()
