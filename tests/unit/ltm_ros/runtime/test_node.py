import threading
from collections.abc import Callable, Mapping

import pytest
import rclpy
from std_msgs.msg import Header

from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Topic
from ltm_ros.runtime.node import QUEUE, HandlerNode


class Slow(Handler[NodeConfig]):
    """Works on an image until it may go on."""

    go_on = threading.Event()

    @property
    def subscriptions(self) -> Mapping[Topic, Callable[[Header], None]]:
        return {Topic("image", Header): lambda _: self.go_on.wait(60)}


def test_while_a_node_works_its_clock_takes_no_message_s_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init(args=["--ros-args", "-p", "site:=s.yaml"])
    node = HandlerNode(NodeType("slow", NodeConfig, Slow))
    try:
        (take,) = node.handler.subscriptions.values()
        node._offer(take, Header())
        for _ in range(2 * QUEUE):  # one tick each half second
            node._tick()
        for _ in range(QUEUE - 2):
            node._offer(take, Header())
        assert node.health.dropped == {}
    finally:
        Slow.go_on.set()
        assert node.close() == 0
        node.destroy_node()
        rclpy.try_shutdown()
