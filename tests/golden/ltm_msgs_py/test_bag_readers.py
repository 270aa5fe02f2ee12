"""What nobody here wrote reads our bags: `rosbags` and `mcap-ros2-support` against our own reader, field by field."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from mcap.writer import CompressionType
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from ltm_core.fuel.codes import FuelClimate
from ltm_core.fuel.decision import layers_of_classes
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.cells import fuel_cells_to_msg
from ltm_msgs_py.grid import classes_to_msg, tile_to_msg
from ltm_msgs_py.image import compressed_to_msg, depth_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import make_header, ns_to_time

T0 = 1_700_000_000_123_456_789
LATCHED = {"/ridge/fuel_map", "/ridge/fuel_map/info", "/ridge/east/labels/info"}


def every_message() -> dict[str, Any]:
    """One message of each kind that the graph publishes or records, by topic."""
    rng = np.random.default_rng(7)
    rgb = rng.integers(0, 256, (18, 31, 3), np.uint8)
    depth = rng.random((18, 31), np.float32) * 4000
    depth[0, :5], depth[3, 4] = np.inf, np.nan
    camera = Camera(31, 18, 40.5, 41.25, 15.0, 8.5, (-0.1155, 0.02, 1e-4, -2e-4, 0.003))
    pose = Pose.from_angles((412.25, -1803.5, 770.0), 230.77, -5.79, -0.77)
    grid = GridGeometry(-585.0, 315.0, 30.0, 5, 3)
    classes = np.array([[0, 1, 2, 3, 4], [255, 5, 6, 255, 1], [2, 2, 255, 0, 6]], np.uint8)
    votes = CellVotes(
        grid,
        np.array([0, 0, 2], np.int32),
        np.array([1, 4, 3], np.int32),
        np.arange(12, dtype=np.uint32).reshape(3, 4) * 1_000_003,
        np.array([751.5, 749.25, np.nan], np.float32),
        T0,
        "east",
    )
    diagnostics = DiagnosticArray()
    diagnostics.header.stamp = ns_to_time(T0)
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name="depth: é", message="1 drop", hardware_id="")
    status.values = [KeyValue(key="rate", value="9.98"), KeyValue(key="drops", value="1")]
    diagnostics.status = [status]
    layers = replace(layers_of_classes(classes, None, FuelClimate.named("dry")), last_seen=np.full(classes.shape, T0))
    return {
        "/ridge/east/image_raw": image_to_msg(rgb, "rgb8", T0, "east_optical"),
        "/ridge/east/image_raw/compressed": compressed_to_msg(encode_rgb(rgb), "jpeg", T0, "east_optical"),
        "/ridge/east/labels/image": image_to_msg(rgb[..., 0], "mono8", T0, "east_optical"),
        "/ridge/east/depth/image": depth_to_msg(depth, T0, "east_optical"),
        "/ridge/east/alignment": image_to_msg(np.dstack([depth] * 3), "32FC3", T0, "map"),
        "/ridge/east/camera_info": camera_to_msg(camera, T0, "east_optical"),
        "/ridge/east/pose": pose_to_msg(pose, T0, covariance=np.arange(36.0).reshape(6, 6)),
        "/ridge/east/pose_stamped": PoseStamped(header=make_header(T0, "map"), pose=pose_to_msg(pose, T0).pose.pose),
        "/ridge/east/labels/info": String(data='{"unlabelled": 255, "place": "Ångström"}'),
        "/ridge/east/fuel/votes": votes_to_msg(votes, ("grass", "shrub", "tree", "bare")),
        "/ridge/fuel_map": classes_to_msg(classes, grid, T0),
        "/ridge/fuel_map/update": tile_to_msg(classes, grid, (1, 0, 2, 4), T0),
        "/ridge/fuel_map/cells": fuel_cells_to_msg(layers, np.zeros(classes.shape), grid, T0),
        "/diagnostics": diagnostics,
        "/clock": Clock(clock=ns_to_time(T0 + 5)),
    }


@pytest.fixture(scope="module", params=[CompressionType.ZSTD, CompressionType.NONE], ids=["zstd", "plain"])
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Each message twice, in chunks small enough for several of them."""
    path = tmp_path_factory.mktemp("bags") / "every"
    with BagWriter(path, compression=request.param, chunk_size=4000) as writer:
        for topic, msg in every_message().items():
            writer.add_topic(topic, type_name_of(msg), latched=topic in LATCHED)
        for turn in range(2):
            for i, (topic, msg) in enumerate(every_message().items()):
                writer.write(topic, msg, T0 + turn * 10**9 + i * 1000, T0 + turn * 10**9)
    return path


def flat(value: Any) -> Any:
    """A message of any of the three libraries as plain nested values; floats keep their bits."""
    if isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, bytes) and len(value) == 1:
        return value[0]  # rclpy gives a field of type `byte` as bytes, the others as an int
    if isinstance(value, (bytes, bytearray, memoryview)):
        return list(bytes(value))
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) or type(value).__name__ == "array":
        return [flat(v) for v in value]
    if isinstance(value, (list, tuple)):
        return [flat(v) for v in value]
    if hasattr(value, "get_fields_and_field_types"):
        names = list(value.get_fields_and_field_types())
    elif hasattr(value, "__dataclass_fields__"):
        names = [n for n in value.__dataclass_fields__ if n != "__msgtype__"]
    else:
        names = list(value.__slots__)
    return {name: flat(getattr(value, name)) for name in names}


def same(ours: Any, theirs: Any) -> bool:
    if isinstance(ours, dict):
        if not isinstance(theirs, dict):
            return False
        constants = {name for name in theirs if name.isupper()}  # they hold a message's constants as fields too
        return ours.keys() == theirs.keys() - constants and all(same(ours[name], theirs[name]) for name in ours)
    if isinstance(ours, list):
        return (
            isinstance(theirs, list)
            and len(ours) == len(theirs)
            and all(same(a, b) for a, b in zip(ours, theirs, strict=True))
        )
    if isinstance(ours, float) and np.isnan(ours):
        return isinstance(theirs, float) and bool(np.isnan(theirs))
    return bool(ours == theirs)


def by_rosbags(path: Path) -> Iterator[tuple[str, int, Any]]:
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, log_time, raw in reader.messages():
            yield connection.topic, log_time, reader.deserialize(raw, connection.msgtype)


def by_mcap_ros2(path: Path) -> Iterator[tuple[str, int, Any]]:
    (file,) = path.glob("*.mcap")
    for item in read_ros2_messages(str(file)):
        yield item.channel.topic, item.log_time_ns, item.ros_msg


@pytest.mark.parametrize("read", [by_rosbags, by_mcap_ros2])
def test_every_message_decodes_field_by_field(bag: Path, read: Any) -> None:
    reader = BagReader(bag)
    ours = [(m.topic, m.log_time_ns, flat(reader.decode(m))) for m in reader.messages()]
    theirs = [(topic, time, flat(msg)) for topic, time, msg in read(bag)]

    assert reader.damage == ()
    assert len(ours) == 2 * len(every_message())
    assert [(t, n) for t, n, _ in theirs] == [(t, n) for t, n, _ in ours]
    for (topic, time, a), (_, _, b) in zip(ours, theirs, strict=True):
        assert same(a, b), f"{topic} at {time}: {a} is not {b}"


def test_rosbags_takes_the_metadata_as_version_9(bag: Path) -> None:
    with Reader(bag) as reader:
        assert reader.message_count == 2 * len(every_message())
        assert reader.start_time == T0
        assert reader.ros_distro == "jazzy"
        by_topic = {c.topic: c for c in reader.connections}
        for topic, msg in every_message().items():
            connection = by_topic[topic]
            (qos,) = connection.ext.offered_qos_profiles
            assert connection.msgtype == type_name_of(msg)
            assert connection.msgcount == 2
            assert qos.durability.name == ("TRANSIENT_LOCAL" if topic in LATCHED else "VOLATILE")
            assert qos.reliability.name == "RELIABLE"
