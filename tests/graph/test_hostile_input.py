import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from bystander import Bystander
from living_graph import INPUTS, MAP_UPDATE, MAST_DEPTH, NODES, Living
from rclpy.serialization import serialize_message
from scenes.small_site import NAME, SmallSite

from ltm_core.fuel.votes import CellVotes
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.image import encode_rgb
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    DEPTH_IMAGE,
    FUEL_MAP_UPDATE,
    FUEL_VOTES,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    POSE,
)

pytestmark = pytest.mark.graph


@pytest.fixture(scope="module")
def living(small_site: SmallSite, module_ros_domain: int) -> Iterator[Living]:
    # Every frame that is sent is looked for: they wait for each other, as in a replay.
    # And none is given up while the tests run, however long a busy machine makes them: it would be counted in another.
    parameters = {"capture": {"shed": False}, "fuel_votes": {"max_wait": 600.0}}
    whole = describe(small_site.site, small_site.path, parameters=parameters)
    graph = Graph(NAME, tuple(whole.node(label) for label in NODES))
    runner = Runner(graph, domain_id=module_ros_domain, console=lambda line: None)
    with runner, Bystander() as bystander:
        runner.wait_until_ready(120.0)
        bystander.listen(MAP_UPDATE, FUEL_MAP_UPDATE.type)
        bystander.listen(MAST_DEPTH, DEPTH_IMAGE.type)
        for topic, name in INPUTS.items():
            bystander.open(name, topic.type)
        living = Living(small_site, runner, bystander)
        bystander.wait_for_wiring(len(graph))
        living.good_frame()
        yield living
        assert living.counters() == living.counted, "something was counted after the last test had looked"


@pytest.fixture
def survives(living: Living) -> Callable[..., None]:
    """Call it, after sending, with what must have been counted, `{node: {counter: increase}}`.

    A good frame comes through, nothing else has been counted, and every node is still the same process.
    """
    pids = living.pids()

    def check(expected: dict[str, dict[str, int]]) -> None:
        living.good_frame()
        deadline = time.monotonic() + 60.0
        while True:
            now = living.counters()
            more = {label: dict(now[label] - living.counted[label]) for label in NODES}
            grown = {label: counters for label, counters in more.items() if counters}
            if grown == expected or time.monotonic() > deadline:
                break
        living.counted = now
        assert grown == expected
        assert living.pids() == pids
        assert all(process.starts == 1 for process in living.runner.processes.values())

    return check


def test_broken_messages_of_a_camera(living: Living, survives: Callable[..., None]) -> None:
    for data in (living.jpeg[: len(living.jpeg) // 2], encode_rgb(np.zeros((90, 161, 3), np.uint8))):
        stamp = living.stamp()
        living.posed(stamp, living.image(stamp, data))
    short, vast = living.raw(living.stamp()), living.raw(living.stamp())
    short.data = short.data[:-1]
    vast.width = vast.height = vast.step = 2**32 - 1
    living.send(IMAGE_RAW, short, vast)
    uncalibrated = living.info(living.stamp())
    uncalibrated.k = np.zeros(9)
    living.send(CAMERA_INFO, uncalibrated)
    for topic, make in ((IMAGE_COMPRESSED, living.image), (POSE, living.pose), (CAMERA_INFO, living.info)):
        message = make(0)
        message.header.stamp.sec = -5
        living.send(topic, message)
    tower = {"dropped.image": 2, "dropped.camera": 1, "dropped.message": 3}
    survives({"tower/capture": tower, "mast/capture": {"dropped.image": 1, "dropped.too_large": 1}})


def test_votes_of_a_foreign_grid(living: Living, survives: Callable[..., None]) -> None:
    small, names = living.small, LabelSet.load().names
    geometry = small.site.fuel_geometry(small.dem)

    def votes(shift: float = 0.0) -> Any:
        rows, cols = np.array([3, 4], np.int32), np.array([7, 2], np.int32)
        counts, looks = np.ones((2, len(names)), np.uint32), np.zeros(2, np.float32)
        grid = geometry.translated(shift, 0.0)
        return votes_to_msg(CellVotes(grid, rows, cols, counts, looks, living.stamp(), "tower"), names)

    cut, vast, good = votes(), votes(), votes()
    cut.data = cut.data[:-3]
    vast.width = vast.height = vast.row_step = 2**32 - 1
    living.send(FUEL_VOTES, votes(shift=15.0), cut, vast, good, good)
    survives({"fuel_map": {"dropped.message": 3, "dropped.duplicate": 1}})


def test_bytes_that_are_no_message(living: Living, survives: Callable[..., None]) -> None:
    """DDS itself refuses them; that they are missing is seen on topics that have one writer."""
    for topic in INPUTS:
        living.send(topic, b"\x00\x01\x00\x00\xff", b"\x00\x01\x00\x00" + b"\xff" * 60)
    survives({"tower/capture": {"dropped.lost": 6}, "mast/capture": {"dropped.lost": 2}})


def test_names_that_are_no_text(living: Living, survives: Callable[..., None]) -> None:
    """ROS strings are bytes: nothing makes a driver send UTF-8."""
    stamp = living.stamp()
    for topic, message in (
        (CAMERA_INFO, living.info(stamp)),
        (POSE, living.pose(stamp)),
        (IMAGE_COMPRESSED, living.image(stamp)),
        (IMAGE_RAW, living.raw(stamp)),
    ):
        name = b"map" if topic is POSE else b"_optical"
        data = serialize_message(message)
        assert name in data
        living.send(topic, data.replace(name, b"\xff" * len(name)))
    living.bystander.wait_for_stamp(MAST_DEPTH, stamp)
    survives({"tower/capture": {"dropped.pose": 1, "dropped.no_pose": 1}})
