import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ltm_core.site.sections import CameraConfig
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import depth_to_msg, image_to_msg, msg_to_array, msg_to_depth
from ltm_ros.recordings.frame_stream import FrameStream, Parts
from ltm_ros.runtime.topics import DEPTH_IMAGE, LABELS_IMAGE

PARTS: Parts = {"depth": ((DEPTH_IMAGE, msg_to_depth),), "labels": ((LABELS_IMAGE, msg_to_array),)}
SECOND = 1_000_000_000
RIDGE: Any = SimpleNamespace(name="ridge", cameras={"north": CameraConfig(), "east": CameraConfig()})
"""What a stream needs of a site."""


def write(bag: BagWriter, camera: str, topic: str, stamp: int, log_time: int, value: int, side: int = 2) -> None:
    if topic == "depth":
        message = depth_to_msg(np.full((side, side + 1), value, np.float32), stamp, "c")
        bag.write(f"/ridge/{camera}/depth/image", message, log_time)
    else:
        message = image_to_msg(np.full((side, side + 1), value, np.uint8), "mono8", stamp, "c")
        bag.write(f"/ridge/{camera}/labels/image", message, log_time)


def test_late_and_lost_messages(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        write(bag, "north", "depth", 3 * SECOND, 3 * SECOND, 3)
        write(bag, "east", "labels", 3 * SECOND, 3 * SECOND, 33)
        write(bag, "north", "depth", 5 * SECOND, 5 * SECOND, 5)
        write(bag, "north", "labels", 5 * SECOND, 6 * SECOND, 5)
        write(bag, "north", "labels", 4 * SECOND, 6 * SECOND, 4)  # its depth was lost
        write(bag, "east", "depth", 3 * SECOND, 7 * SECOND, 33)
        write(bag, "north", "labels", 3 * SECOND, 8 * SECOND, 3)  # late
    stream = FrameStream(tmp_path / "bag", RIDGE, PARTS, ["north", "east"])
    whole = list(stream.frames(["depth", "labels"]))
    assert [(f.camera_name, f.stamp_ns // SECOND) for f in whole] == [("east", 3), ("north", 3), ("north", 5)]
    for frame in whole:
        assert frame.take("depth")[0, 0] == frame.take("labels")[1, 2]
    everything = list(stream.frames(cameras=["north"]))
    assert [f.stamp_ns // SECOND for f in everything] == [3, 4, 5]
    assert "depth" not in everything[1]
    assert everything[1].take("depth") is None


def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    def peak(frames: int) -> int:
        path = tmp_path / str(frames)
        with BagWriter(path) as bag:
            for second in range(frames):
                # Noise does not compress, so chunks are as large as what is in them.
                depth = np.random.default_rng(second).random((300, 301), np.float32)
                bag.write("/ridge/north/depth/image", depth_to_msg(depth, second * SECOND, "c"), second * SECOND)
                write(bag, "north", "labels", second * SECOND, second * SECOND + 1, second % 7, 300)
        tracemalloc.start()
        stream = FrameStream(path, RIDGE, PARTS, ["north"])
        assert sum(float(f.take("depth")[0, 0]) >= 0 for f in stream.frames(["depth", "labels"])) == frames
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    # Sixty frames more are 22 MB: a third of them held would show, and nothing else that a process does is so large.
    few, many = peak(30), peak(90)
    assert many - few < 7 << 20
