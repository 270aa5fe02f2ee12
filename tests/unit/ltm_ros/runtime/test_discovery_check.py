"""Whether a node hears all that publish for it, from what it and the graph know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="the ROS extra is not installed")

from ltm_ros.runtime.delivery_checks import unheard, unmatched


@dataclass
class Subscription:
    topic_name: str
    matched: int

    def get_publisher_count(self) -> int:
        return self.matched


class Graph:
    """A node that listens, in a graph where so many publish on, or listen to, each topic."""

    def __init__(self, known: dict[str, int], **matched: int) -> None:
        self._known = known
        self.subscriptions = [Subscription(f"/{name}", count) for name, count in matched.items()]

    def count_publishers(self, topic: str) -> int:
        return self._known[topic]


@dataclass
class End:
    """A listener, by its node's namespace and name."""

    node_namespace: str
    node_name: str


class Heard:
    """A node in a graph where these nodes listen to each topic."""

    def __init__(self, **listeners: list[str]) -> None:
        self._listeners = listeners

    def get_subscriptions_info_by_topic(self, topic: str) -> list[End]:
        return [End(*name.rsplit("/", 1)) for name in self._listeners[topic.rpartition("/")[2]]]


def test_a_publisher_that_is_known_and_not_matched_is_not_heard() -> None:
    node: Any = Graph({"/pose": 2, "/image": 1, "/clock": 0}, pose=1, image=1, clock=0)
    assert list(unheard(node)) == ["/pose"]
    assert "1 of 2 publishers" in unheard(node)["/pose"]


def test_one_that_the_graph_has_forgotten_first_is_no_trouble() -> None:
    node: Any = Graph({"/image": 0}, image=1)
    assert unheard(node) == {}


def test_a_publisher_s_own_word_is_compared_with_the_graph() -> None:
    node: Any = Heard(pose=["/ridge/x", "/ridge/north/depth", "/ridge/y"], map=["/ridge/x"])
    summaries = {
        "/ridge/north/capture": {"listeners.pose": "2", "queue": "9"},
        "/ridge/north/depth": {},
        "/ridge/x": {"listeners./ridge/map": "1"},
        "/ridge/y": {},
    }
    assert unmatched(node, summaries) == ["/ridge/north/pose"]


@pytest.mark.parametrize(("matched", "loose"), [("1", True), ("2", False), ("3", False), ("0", True)])
def test_who_is_no_node_of_the_site_is_not_waited_for(matched: str, loose: bool) -> None:
    """One of three listeners is somebody's own program; a node whose name has not come yet may be one of ours."""
    for second in ("/ridge/x", "/_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_"):
        node: Any = Heard(pose=["/ridge/y", second, "/ros2cli_echo"])
        summaries = {"/ridge/capture": {"listeners.pose": matched}, "/ridge/x": {}, "/ridge/y": {}}
        assert bool(unmatched(node, summaries)) == loose


def test_more_than_listen_are_as_wrong_as_fewer() -> None:
    node: Any = Heard(pose=["/ridge/y"])
    assert unmatched(node, {"/ridge/capture": {"listeners.pose": "2"}, "/ridge/y": {}}) == ["/ridge/pose"]
