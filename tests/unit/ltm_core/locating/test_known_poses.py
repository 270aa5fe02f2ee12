"""Which pose of a camera a region is taken to have been marked under."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.geometry.pose import Pose
from ltm_core.locating.tracks import MOST, KnownPoses


def pose(azimuth_deg: float) -> Pose:
    return Pose.from_angles((10.0, 20.0, 30.0), azimuth_deg, -5.0)


def azimuth(found: tuple[Pose, object] | tuple[Pose, object, int] | None) -> float:
    assert found is not None
    return round(found[0].angles_deg[0], 6)


def known(stamps: range) -> KnownPoses:
    """The azimuth in degrees is a hundredth of the stamp."""
    poses = KnownPoses()
    for stamp in stamps:
        poses.add(stamp, pose(stamp / 100), np.eye(6) * stamp)
    return poses


def test_the_pose_of_the_stamp_itself_or_the_last_before_it() -> None:
    poses = known(range(1000, 2000, 100))
    assert azimuth(poses.at(1300, 0)) == 13.0
    assert azimuth(poses.at(1399, 99)) == 13.0
    assert poses.at(1399, 98) is None
    assert poses.at(999, 10_000) is None


def test_the_newest_is_the_one_told_last() -> None:
    """Whatever its stamp: a clock may have been set back."""
    poses = known(range(1000, 1300, 100))
    poses.add(1100, pose(77.0), np.eye(6))
    assert azimuth(poses.newest) == 77.0
    assert poses.newest[2] == 1100
    assert azimuth(poses.at(1150, 60)) == 77.0  # of one stamp, what came last
    assert azimuth(poses.at(1250, 60)) == 12.0


def test_so_many_are_remembered_and_the_first_told_go() -> None:
    assert not KnownPoses()
    poses = known(range(1, MOST + 4))
    assert poses
    assert poses.at(3, 10) is None
    assert azimuth(poses.at(4, 10)) == 0.04
    with pytest.raises(LookupError):
        _ = KnownPoses().newest
