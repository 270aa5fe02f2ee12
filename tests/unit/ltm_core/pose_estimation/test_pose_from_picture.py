"""A pose found in its picture: the terrain's horizon, the photo's skyline, the search, its verdicts, whole mounts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes.mountain_view import BEND, CAMERA, eye, mountains, terrain, view

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.errors import ImageError, PoseError
from ltm_core.grid import GridGeometry
from ltm_core.pose import Pose
from ltm_core.pose_estimation import pose_from_picture
from ltm_core.pose_estimation.image_skyline import image_skyline
from ltm_core.pose_estimation.mount_fit import MountFit, fit_mount, widened
from ltm_core.pose_estimation.picture_evidence import picture_evidence
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig, VerdictConfig
from ltm_core.pose_estimation.picture_pose_io import doubt_of_sky, result_of
from ltm_core.pose_estimation.pose_from_picture import find_pose
from ltm_core.pose_estimation.pose_hypothesis import Hypothesis
from ltm_core.pose_estimation.pose_prior import UNKNOWN_DEG, PosePrior, angles_between, turned
from ltm_core.pose_estimation.pose_refinement import ROUNDS
from ltm_core.pose_estimation.terrain_horizon import terrain_horizon
from ltm_core.rotations import matrix_of_vector, vector_of_matrix
from ltm_core.tracing.possible_ground import NOTHING_BEYOND, PossibleGround
from ltm_core.vision.labels import Label

TRUE = Pose.from_angles(eye(), 63.0, 2.5, 1.2)


def walls(near: float = 30.0, far: float = 90.0) -> Dem:
    """Flat ground at 100 m with two walls from west to east, 400 m and 1000 m north of y = 200."""
    geometry = GridGeometry(0.0, 1500.0, 5.0, 240, 300)
    rows, cols = np.mgrid[0:300, 0:240]
    _, y = geometry.to_map(rows, cols)
    z = np.full(y.shape, 100.0)
    z[np.abs(y - 600.0) < 6] += near
    z[np.abs(y - 1200.0) < 6] += far
    return Dem(z.astype(np.float32), geometry)


def test_the_horizon_of_two_walls() -> None:
    horizon = terrain_horizon(walls(), np.array([600.0, 200.0, 110.0]), BEND, NOTHING_BEYOND, half_width=0.2)
    straight = int(np.argmin(np.abs(horizon.azimuths)))
    assert horizon.range[straight] == pytest.approx(995.0, abs=6.0)
    r = horizon.range[straight]
    assert horizon.tangent[straight] == pytest.approx(80.0 / r - BEND * r, abs=1e-4)
    # The lower wall before it is an occluding contour, and what comes into view behind it is the higher one.
    contours = horizon.contours
    k = int(np.argmin(np.abs(contours.azimuth)))
    assert contours.range[k] == pytest.approx(395.0, abs=6.0)
    assert contours.tangent[k] == pytest.approx(20.0 / contours.range[k], abs=1e-3)
    assert contours.behind[k] == pytest.approx(990.0, abs=12.0)
    assert contours.following[k] == k + 1
    assert not horizon.open.any()


def test_a_caption_and_a_corner_do_not_cover_the_sky_and_a_mast_is_no_skyline() -> None:
    photo, labels = view(TRUE)
    plain = picture_evidence(photo, labels, CAMERA).skyline
    assert plain is not None
    rows, cols = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    caption = rows < CAMERA.height // 20
    corner = rows + cols < CAMERA.height // 4
    mast = (np.abs(cols - 3 * CAMERA.width // 4) < CAMERA.width // 20) & (rows > CAMERA.height // 10)
    hidden = caption | corner | mast
    spoilt = np.where(hidden, np.uint8(Label.TREE), labels)
    found = picture_evidence(photo, spoilt, CAMERA, hidden=hidden).skyline
    assert found is not None
    assert len(found.covered_u) == len(plain.covered_u) == 0
    behind_mast = np.abs(plain.u - 3 * CAMERA.width // 4) < CAMERA.width // 20 - 1
    beside = ~np.isin(plain.u, plain.u[np.abs(plain.u - 3 * CAMERA.width // 4) < CAMERA.width // 20 + 1])
    assert not np.isin(found.u, plain.u[behind_mast]).any()
    assert np.isin(plain.u[beside], found.u).mean() > 0.98
    both = np.isin(found.u, plain.u)
    np.testing.assert_allclose(found.v[both], plain.v[np.isin(plain.u, found.u)], atol=0.6)


def test_land_beyond_the_dem_leaves_the_horizon_open() -> None:
    place = np.array([600.0, 200.0, 110.0])
    low = terrain_horizon(walls(), place, BEND, PossibleGround(highest=150.0), half_width=0.2)
    high = terrain_horizon(walls(), place, BEND, PossibleGround(highest=900.0), half_width=0.2)
    assert not low.open.any(), "no higher than the wall of 190 m"
    assert high.open.all()
    assert (high.bound > high.tangent + 0.1).all()


def test_a_place_beside_the_dem_is_told() -> None:
    with pytest.raises(PoseError, match="no known terrain around"):
        terrain_horizon(walls(), np.array([90_000.0, 200.0, 110.0]), BEND)


def test_the_photo_s_skyline_is_found_to_a_part_of_a_pixel() -> None:
    rows, cols = np.mgrid[0:200, 0:320]
    true = 90.0 + 0.11 * cols[0] + 6 * np.sin(cols[0] / 23.0)
    ground = np.clip(rows - true + 0.5, 0, 1)[..., None]
    photo = (ground * [60.0, 70.0, 40.0] + (1 - ground) * [180.0, 200.0, 230.0]).astype(np.uint8)
    rough = np.where(rows < true + 2.4, np.uint8(Label.SKY), np.uint8(Label.SHRUB)).astype(np.uint8)
    found = image_skyline(photo, rough)
    away = found.v - true[found.u.astype(int)]
    assert len(found.u) > 200
    assert np.median(np.abs(away)) < 0.15
    assert np.percentile(np.abs(away), 90) < 0.4
    assert (found.cover == Label.SHRUB).all()


@pytest.mark.parametrize("off", [(1.4, -0.5, 0.4), (-7.0, 0.6, -0.7)])
def test_a_disturbed_pose_is_found_again(off: tuple[float, float, float]) -> None:
    photo, labels = view(TRUE)
    start = Pose.from_angles(TRUE.position, *np.add(TRUE.angles_deg, off))
    prior = PosePrior(start, max(1.5, abs(off[0]) / 1.5), 0.6, 0.6)
    search = find_pose(picture_evidence(photo, labels, CAMERA), terrain(), prior)
    assert search.verdict.word == "accepted", search.verdict.reason
    result = result_of(search, prior, CAMERA)
    away = np.degrees(angles_between(TRUE, result.pose))
    assert np.abs(away).max() < 0.1
    assert (np.abs(away) < 4 * np.array(search.verdict.sigma_deg)).all()


def test_a_pose_settles_where_its_rounds_end_too_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    photo, labels = view(TRUE)
    evidence = picture_evidence(photo, labels, CAMERA)
    prior = PosePrior(Pose.from_angles(TRUE.position, *np.add(TRUE.angles_deg, (1.4, -0.5, 0.4))), 1.5, 0.6, 0.6)
    whole = find_pose(evidence, terrain(), prior).hypotheses[0].refined.pose
    monkeypatch.setattr(pose_from_picture, "ROUNDS", ROUNDS[:1])
    soon = find_pose(evidence, terrain(), prior).hypotheses[0].refined.pose
    assert np.abs(np.degrees(angles_between(whole, soon))).max() < 0.001


def test_without_any_heading() -> None:
    photo, labels = view(TRUE)
    start = Pose.from_angles(TRUE.position, 251.0, TRUE.angles_deg[1] + 0.3, TRUE.angles_deg[2] - 0.3)
    search = find_pose(picture_evidence(photo, labels, CAMERA), terrain(), PosePrior(start, UNKNOWN_DEG, 0.5, 0.5))
    assert search.verdict.word == "accepted", search.verdict.reason
    assert np.abs(np.degrees(angles_between(TRUE, search.hypotheses[0].refined.pose))).max() < 0.1


def test_a_wrong_focal_length_is_found() -> None:
    photo, labels = view(TRUE)
    wrong = replace(CAMERA, fx=CAMERA.fx * 1.06, fy=CAMERA.fy * 1.06)
    prior = PosePrior(TRUE, 1.5, 0.5, 0.5)
    search = find_pose(picture_evidence(photo, labels, wrong), terrain(), prior, focal_sigma=0.04)
    assert result_of(search, prior, wrong).camera.fx == pytest.approx(CAMERA.fx, rel=0.005)


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


def test_fog_is_no_skyline() -> None:
    fog = np.full((300, 480, 3), 190, np.uint8)
    labels = np.full((300, 480), np.uint8(Label.SKY), np.uint8)
    prior = PosePrior(TRUE, 1.5, 0.5, 0.5)
    search = find_pose(picture_evidence(fog, labels, CAMERA), terrain(), prior)
    assert search.verdict.word == "no_skyline"
    assert not result_of(search, prior, CAMERA).accepted


def test_a_picture_of_elsewhere_is_not_accepted() -> None:
    """Taken 80 degrees away from where a good mount says it looks."""
    photo, labels = view(Pose.from_angles(TRUE.position, 143.0, 2.5, 1.2))
    prior = PosePrior(TRUE, 1.5, 0.5, 0.5)
    search = find_pose(picture_evidence(photo, labels, CAMERA), terrain(), prior)
    assert search.verdict.word != "accepted"


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


def test_a_mount_that_looks_backwards_is_not_two() -> None:
    """Of two presets the one asks for a turn of just less than half a circle to the right, the other to the left."""
    little = np.radians(0.02)
    priors, searches = [], []
    true = [Pose.from_angles(eye(), azimuth, 2.0, 0.0) for azimuth in (20.0, 205.0)]
    for pose, turn in zip(true, (np.pi - little, np.pi + little), strict=True):
        told = turned(pose, np.array([0.0, 0.0, turn]))
        priors.append(PosePrior(told, UNKNOWN_DEG, 0.5, 0.5))
        searches.append(find_pose(picture_evidence(*view(pose), CAMERA), terrain(), PosePrior(pose, 1.5, 0.5, 0.5)))
    fit = fit_mount(priors, searches, tilt_zero_sigma_deg=0.0)
    assert fit.word == "accepted", fit.reason
    for k, pose in enumerate(true):
        assert np.abs(np.degrees(angles_between(pose, fit.poses[k]))).max() < 0.08


@pytest.mark.parametrize("heading_deg", [0.0, 100.0, 170.0])
def test_a_mount_may_tip_as_far_whatever_its_heading(heading_deg: float) -> None:
    """By 2.9 sigmas about each level axis, of the 4 that contradict what is stated."""
    told = matrix_of_vector(np.radians([1.45, 1.45, 0.0])) @ matrix_of_vector([0.0, 0.0, np.radians(heading_deg)])
    away = vector_of_matrix(told.T)
    true = [Pose.from_angles(eye(), azimuth, 2.0, 0.0) for azimuth in (20.0, 205.0)]
    fit = fit_mount(
        [PosePrior(turned(pose, away), UNKNOWN_DEG, 0.5, 0.5) for pose in true],
        [find_pose(picture_evidence(*view(pose), CAMERA), terrain(), PosePrior(pose, 1.5, 0.5, 0.5)) for pose in true],
        tilt_zero_sigma_deg=0.0,
    )
    assert fit.word == "accepted", fit.reason
    for k, pose in enumerate(true):
        assert np.abs(np.degrees(angles_between(pose, fit.poses[k]))).max() < 0.08


def test_a_mean_that_fits_nowhere_is_not_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here one that lies 1.5 degrees beside all that it is of."""

    def beside(found: list[Hypothesis], *given: object) -> list[Hypothesis]:
        best = found[0]
        mean = replace(best.refined, pose=turned(best.refined.pose, np.radians([0.0, 0.0, 1.5])))
        return [replace(best, refined=mean, about=best.refined.pose), *found[1:]]

    prior = PosePrior(turned(TRUE, np.radians([0.1, 0.0, 0.8])), 1.5, 0.5, 0.5)
    evidence = picture_evidence(*view(TRUE), CAMERA)
    assert find_pose(evidence, terrain(), prior).verdict.word == "accepted"
    monkeypatch.setattr(pose_from_picture, "merged_with_others", beside)
    verdict = find_pose(evidence, terrain(), prior).verdict
    assert verdict.support < 0.75
    assert verdict.word != "accepted"


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


def test_a_mount_whose_pictures_leave_its_azimuth_open_stays_as_stated() -> None:
    geometry = GridGeometry(0.0, 3000.0, 20.0, 170, 150)
    flat = replace(terrain(), dem=Dem(np.full((150, 170), 50.0, np.float32), geometry))
    rows = np.mgrid[0:300, 0:480][0]
    labels = np.where(rows < 150, np.uint8(Label.SKY), np.uint8(Label.GRASS)).astype(np.uint8)
    photo = np.where((rows < 150)[..., None], [200, 210, 230], [90, 90, 50]).astype(np.uint8)
    prior = PosePrior(Pose.from_angles((1700.0, 1500.0, 60.0), 40.0), 1.5, 0.5, 0.5)
    search = find_pose(picture_evidence(photo, labels, CAMERA), flat, prior)
    fit = fit_mount([prior] * 3, [search] * 3, tilt_zero_sigma_deg=0.0)
    assert fit.word in ("ambiguous", "no_skyline")
    assert fit.poses == (prior.pose,) * 3


@pytest.mark.parametrize(("grown", "asked"), [(Label.BARE, "ridges_gap"), (Label.TREE, "plants_gap")])
def test_a_mount_of_which_ridges_alone_tell_is_asked_more(grown: Label, asked: str) -> None:
    """As of a single picture; all other limits are loose here."""
    prior = PosePrior(turned(TRUE, np.radians([0.1, 0.0, 6.0])), 8.0, 0.5, 0.5)
    photo, labels = view(TRUE)
    labels = np.where(labels == Label.BARE, np.uint8(grown), labels).astype(np.uint8)
    evidence = replace(picture_evidence(photo, labels, CAMERA), skyline=None)
    loose = {"most_sigma_deg": 9.0, "most_azimuth_sigma_deg": 9.0, "least_gap": 0.0, "alternative_deg": 0.05}
    loose |= {"ridges_gap": 0.0, "plants_gap": 0.0, "contradiction": 99.0}
    search = find_pose(evidence, terrain(), prior)

    def fit(**limits: float) -> MountFit:
        config = PicturePoseConfig(verdict=VerdictConfig(**(loose | limits)))
        return fit_mount([prior] * 2, [search] * 2, config, tilt_zero_sigma_deg=0.0)

    gap = fit().gap
    assert 0 < gap < math.inf
    assert [fit(**{asked: share * gap}).word for share in (0.9, 1.1)] == ["accepted", "ambiguous"]


def test_a_mount_without_pictures_is_refused() -> None:
    with pytest.raises(PoseError, match="one each"):
        fit_mount([], [])


def test_edges_are_found_once_for_a_picture_with_and_without_its_skyline() -> None:
    evidence = picture_evidence(*view(TRUE), CAMERA)
    assert replace(evidence, skyline=None).edges is evidence.edges
    assert evidence.unseen.edges is not evidence.edges


def test_labels_of_another_size_are_told() -> None:
    photo, labels = view(TRUE)
    with pytest.raises(ImageError, match="must be of one size"):
        picture_evidence(photo, labels[:-1], CAMERA)


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


def test_sigmas_that_are_none_are_told() -> None:
    with pytest.raises(PoseError, match="positive degrees"):
        PosePrior(TRUE, -1.0)
    with pytest.raises(PoseError, match="metres"):
        PosePrior(TRUE, 1.0, position_sigma=-2.0)


def test_the_scene_s_camera_stands_above_its_ground() -> None:
    assert TRUE.position[2] - mountains().elevation_at(*TRUE.position[:2]) == pytest.approx(12.0)
