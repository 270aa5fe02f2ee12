"""What does not come through to a node is in its diagnostics: messages it was late for, a publisher it cannot hear."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from bystander import Bystander
from rclpy.qos import QoSProfile, ReliabilityPolicy
from scenes.small_site import BEGIN_NS, NAME, SmallSite, apart
from scenes.waiting import wait_for

from ltm_msgs_py.image import image_to_msg
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import IMAGE_RAW, camera_topic

pytestmark = pytest.mark.graph

CAPTURE = f"/{NAME}/mast/capture"
IMAGES = camera_topic(NAME, "mast", IMAGE_RAW)
SENT_MEANWHILE = 40


@pytest.fixture
def capture(small_site: SmallSite, ros_domain: int, tmp_path: Path) -> Iterator[tuple[Runner, Bystander]]:
    """The mast's capture node alone, and somebody beside it."""
    node = describe(apart(small_site.site), small_site.path).node("mast/capture")
    with Runner(Graph(NAME, (node,)), domain_id=ros_domain, log_folder=tmp_path) as runner, Bystander() as bystander:
        yield runner, bystander


def test_what_a_stopped_node_missed_is_counted(small_site: SmallSite, capture: tuple[Runner, Bystander]) -> None:
    runner, bystander = capture
    frame = next(f for f in small_site.frames(1) if f.camera_name == "mast")
    photo = small_site.photo(frame)
    bystander.open(IMAGES, IMAGE_RAW.type)
    sent = 0

    def send(count: int) -> None:
        nonlocal sent
        for _ in range(count):
            bystander.send(IMAGES, image_to_msg(photo, "rgb8", BEGIN_NS + sent * 10**9, "mast_optical"))
            sent += 1

    def taken_or_lost() -> int:
        return bystander.count(CAPTURE, "received") + bystander.count(CAPTURE, "dropped.lost")

    send(2)
    wait_for(lambda: taken_or_lost() == sent, "the first images", lambda: bystander.summaries)
    runner.kill("mast/capture", signal.SIGSTOP)
    send(SENT_MEANWHILE)
    runner.kill("mast/capture", signal.SIGCONT)
    wait_for(lambda: taken_or_lost() == sent, "every image, taken or counted", lambda: bystander.summaries)
    # The others waited in the queue, or came before it stood still: a signal takes its time on a busy machine.
    assert bystander.count(CAPTURE, "dropped.lost") >= SENT_MEANWHILE // 4
    assert IMAGES.rpartition("/")[2] in bystander.summaries[CAPTURE]["last_error"]


def test_a_publisher_that_cannot_be_heard_is_told_of(capture: tuple[Runner, Bystander]) -> None:
    """A driver that offers best effort, where the node asks for a reliable one."""
    _, bystander = capture
    offered = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    bystander.node.create_publisher(IMAGE_RAW.type, IMAGES, offered)
    wait_for(
        lambda: (
            f"{IMAGES}: this node is matched with 0 of 1" in bystander.summaries.get(CAPTURE, {}).get("last_error", "")
        ),
        "word of the publisher",
        lambda: bystander.summaries,
    )
