from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TransformStamped
from mcap.writer import Writer
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from scenes.transforms import LINK_OPTICAL, transform_to_msg
from std_msgs.msg import String

from ltm_core.base.errors import LtmError
from ltm_core.geometry.pose import Pose
from ltm_core.site.sections import CameraConfig
from ltm_msgs_py.bag.cdr import TF_TYPE, transforms_to_raw
from ltm_msgs_py.bag.reader import BagReader, TopicInfo
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import image_to_msg
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose, pose_to_msg
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.recordings.inputs import InputReader, decoded_input, recorded_inputs
from ltm_ros.runtime.topics import CAMERA_INFO, POSE

S = 10**9
STATED = Pose.from_angles((1.0, 2.0, 3.0), 40.0, -5.0, 1.0)
COMPRESSED, RAW, INFO = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
STRING, POSED, ODOMETRY = "std_msgs/msg/String", "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry"


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
    if kind == "transform":
        return transform_to_msg(STATED, S, "map", frame)
    if kind == "odometry":
        made = Odometry(header=stated.header, child_frame_id=frame)
        made.pose = stated.pose
        return made
    return stated


@pytest.mark.parametrize("kind", ["with covariance", "stamped", "odometry", "transform"])
def test_poses_of_four_types_are_one(kind: str) -> None:
    message = a_pose(kind)
    taken = decoded_input(POSE, serialize_message(message), type_name_of(message))
    assert type_name_of(taken) == POSED
    assert taken.header == message.header
    assert msg_to_pose(taken, "map").position == pytest.approx(STATED.position)
    assert msg_to_pose(taken, "map").rotation == pytest.approx(STATED.rotation)


@pytest.mark.parametrize(
    ("topic", "message", "encoding"),
    [
        (POSE, a_pose("odometry", "base_link"), "cdr"),
        (POSE, a_pose("odometry", ""), "cdr"),
        (POSE, a_pose("transform", "base_link"), "cdr"),
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


BASE_MAST = Pose.from_angles((0.5, 0.0, 4.0), 90.0)
FRAME = "camera_color_frame"


def turned(seconds: float) -> Pose:
    """The pose of base_link in odom: it moves 2 m and turns 30 degrees a second."""
    return Pose(np.array([2.0 * seconds, 0.0, 1.0]), Pose.from_angles((0, 0, 0), 30.0 * seconds).rotation)


def a_bag(folder: Path, messages: list[tuple[float, str, Any]]) -> BagReader:
    """Messages by seconds of their log; lists of transforms are TFMessages."""
    with BagWriter(folder) as writer:
        for seconds, topic, message in sorted(messages, key=lambda item: item[0]):
            if isinstance(message, list):
                writer.write_raw(topic, TF_TYPE, transforms_to_raw(message), round(seconds * S))
            else:
                writer.write(topic, message, round(seconds * S))
    return BagReader(folder)


def an_image(seconds: float) -> tuple[float, str, Any]:
    picture = image_to_msg(np.zeros((2, 2, 3), np.uint8), "rgb8", round(seconds * S), FRAME)
    return seconds, "/rig/image_raw", picture


def tf(seconds: float, parent: str, child: str, pose: Pose) -> TransformStamped:
    return transform_to_msg(pose, round(seconds * S), parent, child)


STATIC = (1.0, "/tf_static", [tf(0, "base_link", "mast", BASE_MAST), tf(0, "mast", FRAME, LINK_OPTICAL)])
MAP_ODOM = Pose.from_angles((1000.0, 2000.0, 30.0), 10.0)


def read_poses(reader: BagReader, pose: str, start: float = 0.0) -> dict[float, Any]:
    topics = {"image": "/rig/image_raw", "pose": pose}
    inputs = InputReader(reader, site(north={"topics": topics}, other={"topics": topics | {"image": "/other"}}))
    assert inputs.sources
    found = {}
    for message in inputs.messages(inputs.topics, round(start * S)):
        if message.topic == "/ridge/north/pose":  # the other camera has a frame of its own
            content = decoded_input(inputs.topics[message.topic], message.raw, message.type_name)
            found[stamp_of(content) / S] = content
    return found


@pytest.mark.parametrize("start", [0.0, 2.05])
def test_transforms_of_different_rates_lead_to_the_camera(tmp_path: Path, start: float) -> None:
    """map -> odom at 5 Hz, odom -> base_link at 10 Hz, and static ones from before the start."""
    slow = [(2.0 + 0.2 * n, "/tf", [tf(2.0 + 0.2 * n, "map", "odom", MAP_ODOM)]) for n in range(6)]
    quick = [(2.01 + 0.1 * n, "/tf", [tf(2.01 + 0.1 * n, "odom", "base_link", turned(0.1 * n))]) for n in range(10)]
    reader = a_bag(tmp_path / "bag", [an_image(1.5), STATIC, *slow, *quick])
    found = read_poses(reader, "/tf", start)
    assert min(found) == pytest.approx(2.2 if start else 2.01)
    for stamp, message in found.items():
        expected = LINK_OPTICAL.after(BASE_MAST.after(turned(stamp - 2.01).after(MAP_ODOM)))
        pose = msg_to_pose(message, "map")
        assert pose.position == pytest.approx(expected.position, abs=0.02)  # the mast's arc between two samples
        assert pose.rotation == pytest.approx(expected.rotation, abs=1e-9)
        assert msg_to_covariance(message) is None


def test_odometry_of_another_frame_is_the_cameras_by_static_transforms(tmp_path: Path) -> None:
    sent = Odometry(header=pose_to_msg(STATED, 2 * S).header, child_frame_id="base_link")
    sent.pose = pose_to_msg(turned(1.0), 0, covariance=np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.01])).pose
    found = read_poses(a_bag(tmp_path / "bag", [an_image(1.5), STATIC, (2.0, "/odom", sent)]), "/odom")
    pose, covariance = msg_to_pose(found[2.0], "map"), msg_to_covariance(found[2.0])
    expected = LINK_OPTICAL.after(BASE_MAST.after(turned(1.0)))
    assert pose.position == pytest.approx(expected.position)
    assert pose.rotation == pytest.approx(expected.rotation)
    arm = pose.position - turned(1.0).position
    assert covariance[0, 0] == pytest.approx(0.01 * arm[1] ** 2)
    assert covariance[5, 5] == pytest.approx(0.01)


def test_a_topic_of_two_types_loses_only_the_other_type(tmp_path: Path) -> None:
    message = a_pose("stamped")
    raw = serialize_message(message)
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        for kind in (STRING, type_name_of(message)):
            channel = writer.register_channel("/odom", "cdr", writer.register_schema(kind, "ros2msg", b"string data"))
            writer.add_message(channel, S, raw, S)
        writer.finish()
    reader = BagReader(tmp_path / "a.mcap", names={"/odom": "/ridge/north/pose"})
    inputs = InputReader(reader, site(north={}))
    first, second = inputs.messages(inputs.topics)
    with pytest.raises(LtmError):
        decoded_input(POSE, first.raw, first.type_name)
    assert msg_to_pose(decoded_input(POSE, second.raw, second.type_name)).position == pytest.approx(STATED.position)
