"""The live player's own parts: stamps of later rounds, and what it refuses."""

from __future__ import annotations

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from scenes.small_site import SmallSite

from ltm_core.base.errors import RecordingError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import ns_to_time, stamp_of
from ltm_ros.recordings.replay.offline import Selection
from ltm_ros.recordings.replay.run import LivePlayer, _moved, _round_ns


@pytest.mark.parametrize("shift", [1, 999_999_999, 1_000_000_000, 86_400_000_000_123])
def test_moved_message_differs_in_its_stamp_alone(small_site: SmallSite, shift: int) -> None:
    reader = BagReader(small_site.bag)
    for message in reader.messages():
        before = reader.decode(message)
        after = deserialize_message(_moved(message.raw, shift), type(before))
        assert stamp_of(after) == stamp_of(before) + shift
        after.header.stamp = before.header.stamp
        assert after == before


def test_moved_message_in_the_other_byte_order() -> None:
    """Recordings from big-endian machines: the second byte of the encapsulation says so."""
    little = serialize_message(pose_to_msg(Pose.from_angles((1, 2, 3), 4), 5_000_000_007))
    stamp = (5).to_bytes(4, "big") + (7).to_bytes(4, "big")
    big = bytes([0, 0, 0, 0]) + stamp + little[12:]
    moved = _moved(big, 2_000_000_001)
    assert moved == big[:4] + (7).to_bytes(4, "big") + (8).to_bytes(4, "big") + big[12:]


def test_moved_over_a_second() -> None:
    message = camera_to_msg(Camera.from_fov(9, 5, 40.0), 3_999_999_999, "x")
    moved = deserialize_message(_moved(serialize_message(message), 1), type(message))
    assert moved.header.stamp == ns_to_time(4_000_000_000)


def test_rounds_of_a_loop_neither_touch_nor_flood(small_site: SmallSite) -> None:
    whole = Selection.open(small_site.bag, small_site.site)
    # 12 frames in 1.35 s: the next round begins after a pause of a twelfth of that.
    assert _round_ns(whole) == pytest.approx(1.35e9 * 12 / 11, rel=1e-3)
    one = Selection.open(small_site.bag, small_site.site, start=0.1, duration=0.001)
    assert one.frame_count == 1
    assert _round_ns(one) == 10**9


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_rate_must_be_positive(small_site: SmallSite, rate: float) -> None:
    with pytest.raises(RecordingError, match="replay rate must be a positive number"):
        LivePlayer(Selection.open(small_site.bag, small_site.site), rate)


@pytest.mark.parametrize("pause", [0.0, -1.0, float("nan")])
def test_longest_pause_must_be_positive(small_site: SmallSite, pause: float) -> None:
    with pytest.raises(RecordingError, match="longest pause of a replay must be more than 0 s"):
        LivePlayer(Selection.open(small_site.bag, small_site.site), 1.0, pause)
