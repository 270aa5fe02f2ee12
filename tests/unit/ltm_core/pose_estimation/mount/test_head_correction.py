import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scenes.mountain_view import CAMERA, eye, terrain, view

from ltm_core.base.errors import StoreError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose, matrix_of_vector, pose_covariance
from ltm_core.pose_estimation.mount.mount_config import PoseRefinementConfig
from ltm_core.pose_estimation.mount.mount_io import memory_file, recall_memory, write_memory
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_core.pose_estimation.mount.mount_watch import MountState, MountWatch
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.pose_prior import angles_between, turned

PANS = (20.0, 110.0, 205.0, 290.0)
LEAN = np.radians([0.3, -0.25, 0.9])
CONFIG = PoseRefinementConfig(every=0.0, gather=len(PANS), most_gathered=2 * len(PANS))


def covariance(pose: Pose) -> Float64Array:
    return pose_covariance(pose, 0.0, 0.0, 1.5, 0.6, 0.5)


def true_pose(stated: Pose, tilt_zero_deg: float) -> Pose:
    up = matrix_of_vector([np.radians(tilt_zero_deg), 0.0, 0.0])
    return turned(Pose(stated.position, stated.rotation @ up), LEAN)


@cache
def evidence_at(azimuth_deg: float, tilt_zero_deg: float) -> PictureEvidence:
    stated = Pose.from_angles(eye(), azimuth_deg, 2.0)
    return picture_evidence(*view(true_pose(stated, tilt_zero_deg)), CAMERA)


def watched(tilt_zero_deg: float, sigma_deg: float) -> MountWatch:
    watch = MountWatch(terrain(), CONFIG, tilt_zero_sigma_deg=sigma_deg)
    for azimuth in PANS:
        stated = Pose.from_angles(eye(), azimuth, 2.0)
        watch.look(evidence_at(azimuth, tilt_zero_deg), stated, covariance(stated))
    return watch


def most_off_deg(correction: PoseCorrection, tilt_zero_deg: float) -> float:
    """Over pans, most of which no picture was taken at."""
    worst = 0.0
    for azimuth in np.arange(0.0, 360.0, 30.0):
        stated = Pose.from_angles(eye(), float(azimuth), 4.0)
        corrected, _ = correction.applied(stated, covariance(stated))
        away = angles_between(corrected, true_pose(stated, tilt_zero_deg))
        worst = max(worst, float(np.degrees(np.abs(away)).max()))
    return worst


def test_a_tilt_zero_is_found_beside_a_lean() -> None:
    head = watched(0.8, 0.5)
    assert head.state is MountState.HELD, head.reason
    assert np.degrees(head.correction.tilt_zero) == pytest.approx(0.8, abs=0.12)
    assert most_off_deg(head.correction, 0.8) < 0.15


def test_a_lean_alone_turns_into_no_tilt_zero() -> None:
    head, plain = watched(0.0, 0.5), watched(0.0, 0.0)
    assert head.state is MountState.HELD
    assert head.correction.tilt_zero == 0.0
    np.testing.assert_array_equal(head.correction.rotation, plain.correction.rotation)
    np.testing.assert_array_equal(head.correction.angles, plain.correction.angles)


def test_a_restart_keeps_it(tmp_path: Path) -> None:
    kept, path = MountWatch(terrain(), CONFIG), memory_file(tmp_path, "mast")
    found = PoseCorrection(LEAN, np.eye(3) * 1e-6, 0.014, np.array([1e-8, 0.0, -1e-8, 2e-6]))
    kept.become(MountState.HELD, found, "4 pictures agree")
    write_memory(path, kept, "terms")
    again = MountWatch(terrain(), CONFIG)
    assert recall_memory(path, again, "terms")
    assert again.correction.tilt_zero == found.tilt_zero
    np.testing.assert_array_equal(again.correction.tilt_covariance, found.tilt_covariance)
    np.testing.assert_array_equal(again.correction.rotation, LEAN)


@pytest.mark.parametrize(
    "damage",
    [
        {"rotation": [1e300, 0.0, 0.0]},
        {"angles": [[-1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-6]]},
        {"angles": [[1e-6, 1e-6, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-6]]},
        {"tilt_covariance": [1e-3, 0.0, 0.0, 1e-6]},
        {"tilt_zero": 1e9},
    ],
)
def test_a_damaged_file_is_not_taken(tmp_path: Path, damage: dict[str, object]) -> None:
    kept, path = MountWatch(terrain(), CONFIG), memory_file(tmp_path, "mast")
    kept.become(MountState.HELD, PoseCorrection(LEAN, np.eye(3) * 1e-6), "4 pictures agree")
    write_memory(path, kept, "terms")
    path.write_text(json.dumps(json.loads(path.read_text()) | damage))
    again = MountWatch(terrain(), CONFIG)
    with pytest.raises(StoreError, match=r"mount_mast\.json: .*; remove it"):
        recall_memory(path, again, "terms")
    assert again.state is MountState.STATED
