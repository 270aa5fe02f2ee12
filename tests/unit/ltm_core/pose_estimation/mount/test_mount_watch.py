import numpy as np
import pytest
from scenes.mountain_view import CAMERA, TRUE, eye, terrain, view

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.pose_estimation.mount.mount_config import PoseRefinementConfig
from ltm_core.pose_estimation.mount.mount_watch import MountState, MountWatch, clearer_turn
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between, turned
from ltm_core.vision.labels import UNLABELLED

CONFIG = PoseRefinementConfig(every=0.0, gather=3, most_gathered=5)
STATED = TRUE
OFF = np.radians([0.35, -0.2, -1.3])
"""By which the mount is turned about the map's axes against what is stated."""


def covariance(pose: Pose) -> Float64Array:
    return pose_covariance(pose, 0.0, 0.0, 1.5, 0.5, 0.5)


def picture(true: Pose, seed: int) -> PictureEvidence:
    photo, labels = view(true)
    noise = np.random.default_rng(seed).normal(scale=3.0, size=photo.shape)
    return picture_evidence(np.clip(photo + noise, 0, 255).astype(np.uint8), labels, CAMERA)


def off_deg(watch: MountWatch, true: Pose, stated: Pose = STATED) -> float:
    corrected, _ = watch.correction.applied(stated, covariance(stated))
    return float(np.degrees(np.abs(angles_between(corrected, true))).max())


@pytest.fixture(scope="module")
def held() -> MountWatch:
    """Of a mount that is off, after three pictures."""
    watch, true = MountWatch(terrain(), CONFIG), turned(STATED, OFF)
    for seed in range(3):
        assert watch.state is MountState.STATED
        assert watch.look(picture(true, seed), STATED, covariance(STATED))
    return watch


def test_it_finds_how_the_mount_is_off(held: MountWatch) -> None:
    assert held.state is MountState.HELD
    assert off_deg(held, turned(STATED, OFF)) < 0.12
    _, after = held.correction.applied(STATED, covariance(STATED))
    assert np.degrees(np.sqrt(after.diagonal()[3:])).max() < 0.5
    np.testing.assert_array_equal(after[:3, :3], covariance(STATED)[:3, :3])


def test_it_notices_a_slip_and_finds_the_mount_again(held: MountWatch) -> None:
    """By a degree, of a mount that has agreed with its pictures before."""
    for seed in range(3, 6):
        held.look(picture(turned(STATED, OFF), seed), STATED, covariance(STATED))
    assert (held.state, held.slips) == (MountState.HELD, 0)
    slipped = turned(turned(STATED, OFF), np.radians([0.0, 0.0, 1.0]))
    looked = 0
    while held.state is MountState.HELD:
        held.look(picture(slipped, 10 + looked), STATED, covariance(STATED))
        looked += 1
        assert looked <= 10
    assert held.state is MountState.SLIPPED
    assert "turned by -1.0" in held.reason or "turned by -0.9" in held.reason  # azimuth counts clockwise
    assert not held.correction.known
    _, unsure = held.correction.applied(STATED, covariance(STATED))
    assert np.degrees(np.sqrt(unsure.diagonal()[3:])).min() > 90
    for seed in range(30, 33):
        held.look(picture(slipped, seed), STATED, covariance(STATED))
    assert held.state is MountState.HELD
    assert off_deg(held, slipped) < 0.15


def test_fog_tells_nothing() -> None:
    watch = MountWatch(terrain(), CONFIG)
    photo, labels = view(turned(STATED, OFF))
    grey = np.full_like(photo, 200)
    fog = picture_evidence(grey, np.full_like(labels, UNLABELLED), CAMERA)
    for _ in range(CONFIG.gather):
        assert not watch.look(fog, STATED, covariance(STATED))
    assert watch.state is MountState.STATED
    pose, unchanged = watch.correction.applied(STATED, covariance(STATED))
    np.testing.assert_allclose(pose.rotation, STATED.rotation, atol=1e-12)
    np.testing.assert_array_equal(unchanged, covariance(STATED))


def test_poses_that_pictures_contradict_are_told_and_of_no_use() -> None:
    watch, true = MountWatch(terrain(), CONFIG), turned(STATED, np.radians([0.0, 0.0, -6.0]))
    sure = pose_covariance(STATED, 0.0, 0.0, 0.2, 0.2, 0.2)
    for seed in range(3):
        watch.look(picture(true, seed), STATED, sure)
    assert watch.state is MountState.CONTRADICTED
    assert not watch.correction.known
    assert "sigmas" in watch.reason
    assert "+6.0" in watch.reason  # azimuth counts clockwise


def clearer(true: Pose) -> Pose | None:
    """By a picture of a camera that is believed to stand as before."""
    evidence, known = picture_evidence(*view(true), CAMERA), PosePrior(STATED, 1.0, 1.0, 1.0)
    assert evidence.skyline is not None
    horizon = terrain().horizon_for(CAMERA, known)
    return clearer_turn(evidence.skyline, CAMERA, known, horizon)


@pytest.mark.parametrize("turned_deg", [-1.5, 1.0, 1.75])
def test_a_turn_is_seen_on_its_side(turned_deg: float) -> None:
    true = Pose.from_angles(eye(), 63.0 + turned_deg, 2.2, 1.4)
    found = clearer(true)
    assert found is not None
    assert np.degrees(np.abs(angles_between(true, found))).max() < 0.3


def test_a_camera_that_was_not_turned_is_left_alone() -> None:
    assert clearer(Pose.from_angles(eye(), 63.1, 2.4, 1.2)) is None
