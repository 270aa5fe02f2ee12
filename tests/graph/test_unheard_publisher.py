"""A publisher that a node cannot hear is in its diagnostics."""

from __future__ import annotations

from pathlib import Path

import pytest
from bystander import Bystander
from rclpy.qos import QoSProfile, ReliabilityPolicy
from scenes.small_site import NAME, SmallSite, apart
from scenes.waiting import wait_for

from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import IMAGE_RAW, camera_topic

pytestmark = pytest.mark.graph

CAPTURE = f"/{NAME}/mast/capture"
IMAGES = camera_topic(NAME, "mast", IMAGE_RAW)


def test_a_publisher_that_cannot_be_heard_is_told_of(small_site: SmallSite, ros_domain: int, tmp_path: Path) -> None:
    """A driver that offers best effort, where the node asks for a reliable one."""
    node = describe(apart(small_site.site), small_site.path).node("mast/capture")
    offered = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    with Runner(Graph(NAME, (node,)), domain_id=ros_domain, log_folder=tmp_path), Bystander() as bystander:
        bystander.node.create_publisher(IMAGE_RAW.type, IMAGES, offered)

        def error() -> str:
            return bystander.summaries.get(CAPTURE, {}).get("last_error", "")

        wait_for(lambda: f"{IMAGES}: this node is matched with 0 of 1" in error(), "word of the publisher", error)
