from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes.mountain_view import CAMERA, TRUE, eye, view, write_site

from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.pipeline.pose_watch import FRAMES, PoseWatch
from ltm_core.site.site_io import load_site

pytestmark = pytest.mark.kernel

MINUTE_NS = 60 * 10**9


@pytest.fixture(scope="module")
def labels() -> UInt8Array:
    return view(TRUE)[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_site(tmp_path_factory.mktemp("site"), cameras={"north": {}})


def known(pose: Pose, angle_deg: float) -> Float64Array:
    return pose_covariance(pose, 1.0, 1.0, *(angle_deg,) * 3)


def watched(
    site: Path, labels: UInt8Array, pose: Pose, camera: Camera = CAMERA, frames: int = FRAMES, angle_deg: float = 0.1
) -> PoseWatch:
    watch = PoseWatch(load_site(site))
    for k in range(frames):
        watch.look(labels, camera, pose, known(pose, angle_deg), k * MINUTE_NS)
    return watch


def test_a_correct_pose_is_not_reported(site: Path, labels: UInt8Array) -> None:
    assert not watched(site, labels, TRUE).reason
    slightly_off = Pose.from_angles(eye(), 63.6, 2.3, 1.0)
    assert not watched(site, labels, slightly_off).reason


@pytest.mark.parametrize(
    ("pose", "camera"),
    [
        (Pose.from_angles(eye(), 243.0, 2.5, 1.2), CAMERA),
        (Pose.from_angles(eye(), 153.0, 2.5, 1.2), CAMERA),
        (Pose.from_angles(eye(), 63.0, 2.5, 14.0), CAMERA),
        (Pose.from_angles(eye(), 63.0, -3.5, 1.2), CAMERA),
        (TRUE, CAMERA.zoomed(0.6)),
    ],
    ids=["behind", "beside", "rolled", "tilted", "another lens"],
)
def test_a_wrong_pose_is_reported_after_ten_clear_frames(
    site: Path, labels: UInt8Array, pose: Pose, camera: Camera
) -> None:
    assert not watched(site, labels, pose, camera, frames=FRAMES - 1).reason
    assert "contradict the terrain" in watched(site, labels, pose, camera).reason


def test_a_corrected_pose_ends_the_report(site: Path, labels: UInt8Array) -> None:
    wrong = Pose.from_angles(eye(), 243.0, 2.5, 1.2)
    watch = watched(site, labels, wrong)
    for k in range(FRAMES, 2 * FRAMES):
        watch.look(labels, CAMERA, TRUE, known(TRUE, 0.1), k * MINUTE_NS)
    assert not watch.reason


def test_what_cannot_be_judged_is_not_reported(site: Path, labels: UInt8Array, tmp_path: Path) -> None:
    """Fog, a direction that is stated as uncertain, and land beyond the DEM that may stand over its horizon."""
    wrong = Pose.from_angles(eye(), 243.0, 2.5, 1.2)
    assert not watched(site, np.zeros_like(labels), wrong).reason
    assert not watched(site, labels, wrong, angle_deg=10.0).reason
    assert not watched(site, labels, replace(TRUE), frames=1).reason
