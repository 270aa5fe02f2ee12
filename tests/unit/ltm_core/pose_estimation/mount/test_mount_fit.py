from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes.mountain_view import CAMERA, TRUE, eye, terrain, view

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.mount.mount_fit import fit_mount, widened
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, find_pose
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between, turned


@cache
def searched(azimuth_deg: float, pitch_deg: float = 2.0, *off_deg: float) -> tuple[Pose, PosePrior, PictureSearch]:
    """A true pose, what is stated of it, `off_deg` about the map's axes, and what is found."""
    pose = Pose.from_angles(eye(), azimuth_deg, pitch_deg, 0.0)
    prior = PosePrior(turned(pose, np.radians(off_deg or (0.0, 0.0, 0.0))), 1.5, 0.5, 0.5)
    return pose, prior, find_pose(picture_evidence(*view(pose), CAMERA), terrain(), prior)


def test_presets_of_one_head_share_its_mount() -> None:
    lean, tilt = np.radians([0.4, -0.3, 1.3]), np.radians(0.25)
    c, s = np.cos(tilt), np.sin(tilt)
    up = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    priors, searches, true = [], [], []
    for azimuth in (20.0, 110.0, 205.0, 290.0):
        pose = Pose.from_angles(eye(), azimuth, 2.0, 0.0)
        told = turned(Pose(pose.position, pose.rotation @ up), lean)
        prior = PosePrior(told, 1.5, 0.5, 0.5)
        photo, labels = view(pose)
        priors.append(prior)
        true.append(pose)
        searches.append(find_pose(picture_evidence(photo, labels, CAMERA), terrain(), widened(prior, 0.3)))
    fit = fit_mount(priors, searches)
    assert fit.word == "accepted", fit.reason
    for k, pose in enumerate(true):
        assert np.abs(np.degrees(angles_between(pose, fit.poses[k]))).max() < 0.08
        assert fit.pose_covariance(k).shape == (6, 6)
    # Both turn a camera that looks level up and down; the lean is about axes that all share, the zero about its own.
    np.testing.assert_allclose(fit.rotation, -lean, atol=np.radians(0.1))
    assert fit.tilt_zero == pytest.approx(-tilt, abs=np.radians(0.1))


@pytest.mark.parametrize(("sigma_deg", "word"), [(0.08, "ambiguous"), (0.2, "accepted")])
def test_a_picture_that_is_sure_of_another_pitch_contradicts_the_mount(sigma_deg: float, word: str) -> None:
    found = (searched(azimuth, 2.0, 0.2, -0.1, 1.1) for azimuth in (20.0, 110.0, 205.0))
    _, priors, (first, contrary, last) = zip(*found, strict=True)
    best, *others = contrary.hypotheses
    raised = Pose.from_angles(eye(), 110.0, 3.5, 0.0)
    other = replace(best, refined=replace(best.refined, pose=raised))
    verdict = replace(contrary.verdict, sigma_deg=(sigma_deg, 0.05, 0.05))
    contrary = replace(contrary, hypotheses=(other, *others), verdict=verdict)
    fit = fit_mount(priors, [first, contrary, last], tilt_zero_sigma_deg=0.0)
    assert fit.word == word, fit.reason
    assert ("accepted by itself is 1.5 deg" in fit.reason) == (word == "ambiguous")


def test_presets_of_one_head_share_its_focal_length_where_it_is_free() -> None:
    wrong = CAMERA.zoomed(1.06)
    priors, searches = [], []
    true = [Pose.from_angles(eye(), azimuth, 2.0, 0.0) for azimuth in (20.0, 205.0, 290.0)]
    for pose in true:
        prior = PosePrior(turned(pose, np.radians([0.2, -0.1, 1.1])), 1.5, 0.5, 0.5)
        priors.append(prior)
        searches.append(find_pose(picture_evidence(*view(pose), wrong), terrain(), prior, focal_sigma=0.04))
    fit = fit_mount(priors, searches, tilt_zero_sigma_deg=0.0, focal_sigma=0.04)
    assert fit.word == "accepted", fit.reason
    assert wrong.fx * fit.focal == pytest.approx(CAMERA.fx, rel=0.003)
    assert 0 < fit.focal_sigma < 0.01
    assert fit.covariance.shape == (7, 7)
    for k, pose in enumerate(true):
        assert np.abs(np.degrees(angles_between(pose, fit.poses[k]))).max() < 0.08
    held = fit_mount(priors, searches, tilt_zero_sigma_deg=0.0)
    assert (held.focal, held.focal_sigma) == (1.0, 0.0)


def test_copies_of_one_picture_say_no_more_than_the_picture() -> None:
    """Its DEM's errors are the same in all of them."""
    told = turned(TRUE, np.radians([0.1, 0.0, 0.8]))
    prior = PosePrior(told, 1.5, 0.5, 0.5)
    search = find_pose(picture_evidence(*view(TRUE), CAMERA), terrain(), prior)
    once, often = (fit_mount([prior] * n, [search] * n, tilt_zero_sigma_deg=0.0) for n in (1, 4))
    assert once.word == often.word == "accepted"
    np.testing.assert_allclose(often.rotation, once.rotation, atol=1e-6)
    np.testing.assert_allclose(often.covariance, once.covariance, rtol=1e-3, atol=1e-12)
    assert often.gap == pytest.approx(once.gap, rel=1e-3)
