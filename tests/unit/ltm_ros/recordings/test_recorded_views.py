from pathlib import Path

import pytest
from scenes.small_site import TOWER, write_small_site

from ltm_core.base.errors import RecordingError
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.recordings.recorded_run import recorded_views
from ltm_ros.runtime.topics import CAMERA_INFO, POSE, camera_topic


def test_different_views_once_each(tmp_path: Path) -> None:
    small = write_small_site(tmp_path, recording=False)
    with BagWriter(tmp_path / "bag") as bag:
        for number, azimuth in enumerate((10.0, 10.5, 40.0, 10.1, 359.2, 1.0)):
            stamp = 1_700_000_000_000_000_000 + number
            info, pose = camera_to_msg(TOWER, stamp, "tower_optical"), pose_to_msg(small.tower_pose(azimuth), stamp)
            bag.write(camera_topic("hollow", "tower", CAMERA_INFO), info, stamp)
            bag.write(camera_topic("hollow", "tower", POSE), pose, stamp)
    views = recorded_views(tmp_path / "bag", small.site)
    assert [view.name for view in views] == ["tower"] * 3  # the mast's pose stands in the site file
    assert [view.pose.angles_deg[0] for view in views] == pytest.approx([10.0, 40.0, 359.2])
    assert views[0].camera == TOWER


def test_a_recording_of_another_site(tmp_path: Path) -> None:
    small = write_small_site(tmp_path, recording=False)
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/ridge/tower/pose", pose_to_msg(small.tower_pose(10.0), 5), 5)
    with pytest.raises(RecordingError, match=r"no camera_info and pose of the cameras of hollow.*/ridge/tower/pose"):
        recorded_views(tmp_path / "bag", small.site)
