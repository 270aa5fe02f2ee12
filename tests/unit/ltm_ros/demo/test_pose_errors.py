from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.phone_site import phone_site

from ltm_core.base.errors import RecordingError
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.pose import pose_to_msg
from ltm_ros.demo.score import recorded_pose_errors

SIGMAS = (4.0, 7.0, 8.2, 1.0, 2.0)


def bag(folder: Path, poses: dict[int, Pose], stated: bool) -> Path:
    with BagWriter(folder) as writer:
        for stamp, pose in poses.items():
            covariance = pose_covariance(pose, *SIGMAS) if stated else None
            writer.write("/ridge/phone/pose", pose_to_msg(pose, stamp, covariance=covariance), stamp)
    return folder


def test_errors_are_told_minus_true_by_stamp(tmp_path: Path) -> None:
    site = phone_site(tmp_path)
    true = {k: Pose.from_angles((10.0 * k, 5.0, 3.0), 358.0 + k, -4.0, 1.0) for k in (1, 2, 3)}
    told = {
        k: Pose.from_angles(p.position + np.array([1.0, -2.0, 0.5]), p.angles_deg[0] + 6.0, -3.0, -1.5)
        for k, p in true.items()
    } | {9: true[1]}
    found = recorded_pose_errors(bag(tmp_path / "told", told, True), bag(tmp_path / "true", true, False), site)
    assert found.unmatched == 1
    np.testing.assert_allclose(found.errors, np.tile([1.0, -2.0, 0.5, 6.0, 1.0, -2.5], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(found.sigmas, np.tile([4.0, 4.0, 7.0, 8.2, 1.0, 2.0], (3, 1)), rtol=1e-9)
    with pytest.raises(RecordingError, match="no frame of one stamp in common"):
        recorded_pose_errors(bag(tmp_path / "other", {77: true[1]}, False), tmp_path / "true", site)
