"""Pictures taken out of serialised messages without the middleware are what the middleware makes of them."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image

from ltm_core.base.errors import ImageError, RecordingError
from ltm_msgs_py.bag.picture_cdr import COMPRESSED_TYPE, RAW_TYPE, picture_of
from ltm_msgs_py.image import compressed_to_msg, compressed_to_rgb, encode_rgb, image_to_msg, msg_to_rgb

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
    with pytest.raises(RecordingError, match="plain CDR"):
        picture_of(b"\x00\x03" + raw[2:], COMPRESSED_TYPE)
    with pytest.raises(ImageError, match="contains no image"):
        picture_of(raw, "sensor_msgs/msg/Imu")


def test_what_a_task_imports_loads_no_middleware() -> None:
    """A worker shall not wait for it, nor hold its memory."""
    code = "import sys, ltm_ros.archive.task; print('rclpy' in sys.modules, 'distributed' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
