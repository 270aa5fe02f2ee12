"""Which recorded topics are the inputs of a site, and what becomes of messages of other types."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from ltm_core.base.errors import LtmError
from ltm_core.geometry.pose import Pose
from ltm_core.site.sections import CameraConfig
from ltm_msgs_py.bag.reader import TopicInfo
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.pose import msg_to_pose, pose_to_msg
from ltm_msgs_py.sensors import msg_to_camera
from ltm_ros.recordings.inputs import beside_expected, decoded_input, pose_difference, recorded_inputs
from ltm_ros.runtime.topics import CAMERA_INFO, POSE

S = 10**9
STATED = Pose.from_angles((1.0, 2.0, 3.0), 40.0, -5.0, 1.0)
COMPRESSED, RAW, INFO = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
POSED, ODOMETRY = "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry"


def site(**cameras: dict[str, Any]) -> Any:
    return SimpleNamespace(name="ridge", cameras={name: CameraConfig(**given) for name, given in cameras.items()})


def topics(*recorded: tuple[str, str, int]) -> dict[str, TopicInfo]:
    return {name: TopicInfo(kind, count, False) for name, kind, count in recorded}


BOTH = (("/ridge/north/image_raw", RAW), ("/ridge/north/image_raw/compressed", COMPRESSED))


@pytest.mark.parametrize(
    ("given", "recorded", "expected"),
    [
        ({}, [(*BOTH[0], 3)], ["/ridge/north/image_raw"]),
        ({}, [(*BOTH[1], 3)], ["/ridge/north/image_raw/compressed"]),
        ({}, [(*BOTH[0], 3), (*BOTH[1], 3)], ["/ridge/north/image_raw/compressed"]),
        ({}, [(*BOTH[0], 3), (*BOTH[1], 0)], ["/ridge/north/image_raw"]),
        ({}, [(*BOTH[0], 3), (BOTH[1][0], "std_msgs/msg/String", 3)], ["/ridge/north/image_raw"]),
        ({"image": "raw"}, [(*BOTH[0], 3), (*BOTH[1], 3)], ["/ridge/north/image_raw"]),
        ({"image": "compressed"}, [(*BOTH[0], 3)], []),
        ({"topics": {"image": "/rig/image_raw"}}, [("/rig/image_raw", RAW, 3), (*BOTH[1], 3)], ["/rig/image_raw"]),
        ({}, [("/ridge/north/pose", "std_msgs/msg/String", 3)], ["/ridge/north/pose"]),
        ({}, [("/ridge/north/fix", "std_msgs/msg/String", 3)], []),
        ({"topics": {"pose": "/odom"}}, [("/odom", ODOMETRY, 3), ("/ridge/north/pose", POSED, 3)], ["/odom"]),
    ],
)  # fmt: skip
def test_inputs_are_what_the_recording_has(
    given: dict[str, Any], recorded: list[tuple[str, str, int]], expected: list[str]
) -> None:
    assert [*recorded_inputs(site(north=given), topics(*recorded))] == expected


def a_pose(kind: str, frame: str = "north_optical") -> Any:
    stated = pose_to_msg(STATED, S)
    if kind == "stamped":
        return PoseStamped(header=stated.header, pose=stated.pose.pose)
    if kind == "odometry":
        made = Odometry(header=stated.header, child_frame_id=frame)
        made.pose = stated.pose
        return made
    return stated


@pytest.mark.parametrize("kind", ["with covariance", "stamped", "odometry"])
def test_poses_of_three_types_are_one(kind: str) -> None:
    message = a_pose(kind)
    taken = decoded_input(POSE, serialize_message(message), type_name_of(message))
    assert type_name_of(taken) == POSED
    assert taken.header == message.header
    assert pose_difference(STATED, msg_to_pose(taken, "map")) == ""


@pytest.mark.parametrize(
    ("topic", "message", "encoding"),
    [
        (POSE, a_pose("odometry", "base_link"), "cdr"),
        (POSE, a_pose("odometry", ""), "cdr"),
        (POSE, a_pose("stamped"), "json"),
        (POSE, String(data="x"), "cdr"),
        (CAMERA_INFO, String(data="x"), "cdr"),
    ],
)
def test_what_is_no_input_is_an_error(topic: Any, message: Any, encoding: str) -> None:
    with pytest.raises(LtmError):
        decoded_input(topic, serialize_message(message), type_name_of(message), encoding)


@pytest.mark.parametrize("size", [0, 3, 40])
def test_bytes_that_are_too_few_are_an_error(size: int) -> None:
    with pytest.raises(LtmError):
        msg_to_camera(decoded_input(CAMERA_INFO, serialize_message(a_pose("stamped"))[:size], INFO))


def test_topics_are_named_beside_the_expected_ones_with_a_mapping() -> None:
    recorded = {
        "/rig/cam/image_raw": RAW,
        "/rig/cam/depth/image": RAW,
        "/odom": "nav_msgs/msg/Odometry",
        "/tf": "x/msg/Tf",
    }
    said = beside_expected(site(north={"calibration": {"width": 4, "height": 3, "hfov_deg": 60}}), recorded)
    assert "north: {topics: {image: /rig/cam/image_raw, pose: /odom}}" in said
    assert all(f"{name} ({kind})" in said for name, kind in recorded.items())
    assert "/ridge/north/camera_info" not in said, "the site file has it"
    east = beside_expected(site(north={}, east={}), {"/a/east/image_raw": RAW}, ["east"])
    assert "east: {topics: {image: /a/east/image_raw}}" in east
    assert "/ridge/north/pose" not in east
    assert "north: {image: auto}" in beside_expected(site(north={"image": "compressed"}), {BOTH[0][0]: RAW})


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (Pose.from_angles((4.0, 6.0, 3.0), 40.0, -5.0, 1.0), "0.00 degrees and 5.00 m"),
        (Pose.from_angles((1.0, 2.0, 3.0), 40.0, 0.0, 1.0), "5.00 degrees and 0.00 m"),
        (Pose.from_angles((1.0, 2.0, 3.0), 40.0 + 1e-4, -5.0, 1.0), ""),
    ],
)
def test_poses_differ_by_an_angle_and_a_distance(other: Pose, said: str) -> None:
    found = pose_difference(STATED, other)
    assert found.endswith(said) if said else found == ""
