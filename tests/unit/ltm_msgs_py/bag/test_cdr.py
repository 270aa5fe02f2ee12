import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.reader import read_ros2_messages
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from scenes.transforms import transform_to_msg
from sensor_msgs.msg import CompressedImage, Image

from ltm_core.base.errors import ImageError, LtmError, RecordingError
from ltm_core.geometry.pose import Pose
from ltm_msgs_py.bag.cdr import COMPRESSED_TYPE, RAW_TYPE, TF_TYPE, picture_of, transforms_of, transforms_to_raw
from ltm_msgs_py.bag.schemas import type_hash
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, compressed_to_rgb, encode_rgb, image_to_msg, msg_to_rgb
from ltm_msgs_py.pose import msg_to_transform

STAMP_NS = 1_700_000_000_123_456_789
PHOTO = np.random.default_rng(3).integers(0, 256, (30, 47, 3), np.uint8)


@pytest.mark.parametrize("frame_id", ["", "a", "mast_optical", "four"])
def test_a_compressed_picture(frame_id: str) -> None:
    """Whatever length the text before it has, which moves what follows."""
    raw = serialize_message(compressed_to_msg(encode_rgb(PHOTO), "jpeg", STAMP_NS, frame_id))
    picture = picture_of(raw, COMPRESSED_TYPE)
    assert (picture.stamp_ns, picture.size) == (STAMP_NS, (47, 30))
    np.testing.assert_array_equal(picture.rgb(), compressed_to_rgb(deserialize_message(raw, CompressedImage)))


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "mono16"])
@pytest.mark.parametrize("frame_id", ["", "mast_optical"])
def test_a_raw_picture(encoding: str, frame_id: str) -> None:
    pixels = PHOTO if encoding != "mono16" else PHOTO[..., 0].astype(np.uint16) * 200
    raw = serialize_message(image_to_msg(pixels, encoding, STAMP_NS, frame_id))
    picture = picture_of(raw, RAW_TYPE)
    assert (picture.stamp_ns, picture.size) == (STAMP_NS, (47, 30))
    np.testing.assert_array_equal(picture.rgb(), msg_to_rgb(deserialize_message(raw, Image)))


def test_what_is_cut_or_of_another_kind_is_refused() -> None:
    raw = serialize_message(compressed_to_msg(encode_rgb(PHOTO), "jpeg", STAMP_NS, "mast_optical"))
    for end in (0, 3, 4, 10, 14, 30, len(raw) - 9):
        with pytest.raises(RecordingError, match="do not decode as"):
            picture_of(raw[:end], COMPRESSED_TYPE)
    with pytest.raises(RecordingError, match="00 03 00 00"):
        picture_of(b"\x00\x03" + raw[2:], COMPRESSED_TYPE)
    with pytest.raises(ImageError, match="contains no image"):
        picture_of(raw, "sensor_msgs/msg/Imu")


def test_what_a_task_imports_loads_no_middleware() -> None:
    """A worker shall not wait for it, nor hold its memory."""
    code = "import sys, ltm_ros.archive.task; print('rclpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False"]


@pytest.mark.parametrize("names", [[], [("map", "a")], [("odom", "base_link"), ("base", "cam_optical_frame")]])
def test_transforms_are_what_other_readers_make_of_them(names: list[tuple[str, str]], tmp_path: Path) -> None:
    poses = [Pose.from_angles((1.5 + n, -2.0, 3e5), 40.0 + n, -5.0, 2.0) for n in range(len(names))]
    sent = [transform_to_msg(pose, STAMP_NS, *name) for pose, name in zip(poses, names, strict=True)]
    raw = transforms_to_raw(sent)
    assert transforms_of(raw) == sent
    with BagWriter(tmp_path / "bag") as writer:
        writer.write_raw("/tf", TF_TYPE, raw, STAMP_NS)
    store = get_typestore(Stores.ROS2_JAZZY)
    assert type_hash(TF_TYPE) == store.hash_rihs01(TF_TYPE)
    with Reader(tmp_path / "bag") as reader:
        ((_, _, theirs),) = reader.messages()
    (message,) = read_ros2_messages(tmp_path / "bag/bag_0.mcap")
    for read in (store.deserialize_cdr(theirs, TF_TYPE).transforms, message.ros_msg.transforms):
        assert [(t.header.frame_id, t.child_frame_id, t.header.stamp.nanosec) for t in read] == [
            (*name, STAMP_NS % 10**9) for name in names
        ]
        for transform, pose in zip(read, poses, strict=True):
            assert msg_to_transform(transform).position == pytest.approx(pose.position)
            assert msg_to_transform(transform).quaternion == pytest.approx(pose.quaternion)
    assert bytes(store.serialize_cdr(store.deserialize_cdr(raw, TF_TYPE), TF_TYPE)) == raw


@pytest.mark.parametrize("raw", [b"", b"\0\1\0\0\1\0\0\0", b"\0\1\0\0" + b"\xff" * 90])
def test_transforms_of_invalid_bytes_are_an_error(raw: bytes) -> None:
    with pytest.raises(LtmError):
        transforms_of(raw)
