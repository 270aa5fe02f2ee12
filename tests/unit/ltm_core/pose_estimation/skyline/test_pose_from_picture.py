from dataclasses import replace

import numpy as np
import pytest
from scenes.mountain_view import CAMERA, TRUE, terrain, view

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, find_pose
from ltm_core.pose_estimation.skyline.picture_pose_io import doubt_of_sky, result_of
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem, skyline_observations
from ltm_core.pose_estimation.skyline.pose_prior import UNKNOWN_DEG, PosePrior, angles_between
from ltm_core.raster.dem import Dem
from ltm_core.vision.labels import Label

NEAR = PosePrior(Pose.from_angles(TRUE.position, 63.4, 2.3, 1.0), 1.5, 0.6, 0.6)


def test_a_disturbed_pose_is_found_again() -> None:
    photo, labels = view(TRUE)
    prior = PosePrior(Pose.from_angles(TRUE.position, *np.add(TRUE.angles_deg, (-7.0, 0.6, -0.7))), 4.7, 0.6, 0.6)
    search = find_pose(picture_evidence(photo, labels, CAMERA), terrain(), prior)
    assert search.verdict.word == "accepted", search.verdict.reason
    result = result_of(search, prior, CAMERA)
    away = np.degrees(angles_between(TRUE, result.pose))
    assert np.abs(away).max() < 0.1
    assert (np.abs(away) < 4 * np.array(search.verdict.sigma_deg)).all()


def test_without_any_heading() -> None:
    photo, labels = view(TRUE)
    start = Pose.from_angles(TRUE.position, 251.0, TRUE.angles_deg[1] + 0.3, TRUE.angles_deg[2] - 0.3)
    search = find_pose(picture_evidence(photo, labels, CAMERA), terrain(), PosePrior(start, UNKNOWN_DEG, 0.5, 0.5))
    assert search.verdict.word == "accepted", search.verdict.reason
    assert np.abs(np.degrees(angles_between(TRUE, search.hypotheses[0].refined.pose))).max() < 0.1


def test_a_flat_skyline_leaves_the_pose_as_it_came() -> None:
    geometry = GridGeometry(0.0, 3000.0, 20.0, 170, 150)
    flat = replace(terrain(), dem=Dem(np.full((150, 170), 50.0, np.float32), geometry))
    rows = np.mgrid[0:300, 0:480][0]
    labels = np.where(rows < 150, np.uint8(Label.SKY), np.uint8(Label.GRASS)).astype(np.uint8)
    photo = np.where((rows < 150)[..., None], [200, 210, 230], [90, 90, 50]).astype(np.uint8)
    prior = PosePrior(Pose.from_angles((1700.0, 1500.0, 60.0), 40.0), 6.0, 0.7, 0.7)
    search = find_pose(picture_evidence(photo, labels, CAMERA), flat, prior)
    result = result_of(search, prior, CAMERA)
    assert search.verdict.word in ("ambiguous", "no_skyline")
    assert not result.accepted
    assert result.pose is prior.pose
    np.testing.assert_array_equal(result.covariance, prior.covariance)


def test_a_picture_of_elsewhere_is_not_accepted() -> None:
    """Taken 80 degrees away from where a good mount says it looks."""
    photo, labels = view(Pose.from_angles(TRUE.position, 143.0, 2.5, 1.2))
    prior = PosePrior(TRUE, 1.5, 0.5, 0.5)
    search = find_pose(picture_evidence(photo, labels, CAMERA), terrain(), prior)
    assert search.verdict.word != "accepted"


def test_a_photo_upside_down_is_told() -> None:
    _, labels = view(TRUE)
    assert doubt_of_sky(labels) is None
    assert "upside down" in (doubt_of_sky(labels[::-1]) or "")


def test_a_lens_s_distortion_is_taken_out() -> None:
    bent = Camera(480, 300, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, (-0.12, 0.02, 0.0, 0.0, 0.0))
    photo, labels = view(TRUE, bent)
    prior = PosePrior(Pose.from_angles(TRUE.position, 64.2, 2.2, 1.0), 1.5, 0.5, 0.5)
    search = find_pose(picture_evidence(photo, labels, bent), terrain(), prior)
    assert np.abs(np.degrees(angles_between(TRUE, search.hypotheses[0].refined.pose))).max() < 0.12


def uneven(evidence: PictureEvidence, sigmas: float) -> PictureEvidence:
    """Return the evidence with a skyline that is off by `sigmas` standard deviations, up and down in turn."""
    horizon = terrain().horizon_for(evidence.camera, NEAR)
    rows = skyline_observations(TRUE, evidence.camera, PoseProblem(evidence, horizon, NEAR), 1.0)
    assert rows is not None
    assert evidence.skyline is not None
    v = evidence.skyline.v + sigmas * np.where(np.arange(len(rows.sigma)) % 2, 1.0, -1.0) * rows.sigma
    return replace(evidence, skyline=replace(evidence.skyline, v=v))


def sigmas(search: PictureSearch) -> Float64Array:
    return np.asarray(np.sqrt(np.diag(search.hypotheses[0].refined.covariance)[3:6]), np.float64)


def test_misfits_of_the_stated_size_change_nothing_and_twice_as_large_ones_make_a_pose_less_sure() -> None:
    exact = picture_evidence(*view(TRUE), CAMERA)
    found = {size: find_pose(uneven(exact, size), terrain(), NEAR) for size in (0.0, 1.0, 2.0)}
    variance = {size: search.hypotheses[0].refined.skyline.variance for size, search in found.items()}
    assert variance[0.0] < 0.5
    assert variance[1.0] == pytest.approx(1.0, abs=0.25)
    assert 2.0 < variance[2.0] < 4.0  # the square of 2, and two places of what is stated beside
    assert (sigmas(found[0.0]) < sigmas(found[1.0])).all()
    assert (sigmas(found[2.0]) > 1.2 * sigmas(found[1.0])).all()
