"""Whether a node hears all that publish for it, from what it and the graph know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="the ROS extra is not installed")

from ltm_ros.wiring import unheard, unmatched


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

    def count_subscribers(self, topic: str) -> int:
        return self._known[topic]


def test_a_publisher_that_is_known_and_not_matched_is_not_heard() -> None:
    node: Any = Graph({"/pose": 2, "/image": 1, "/clock": 0}, pose=1, image=1, clock=0)
    assert list(unheard(node)) == ["/pose"]
    assert unheard(node)["/pose"].startswith("2 publish /pose, 1 reach this node; ")


def test_one_that_the_graph_has_forgotten_first_is_no_trouble() -> None:
    node: Any = Graph({"/image": 0}, image=1)
    assert unheard(node) == {}


def test_a_publisher_s_own_word_is_compared_with_the_graph() -> None:
    node: Any = Graph({"/ridge/north/pose": 3, "/ridge/map": 1})
    summaries = {
        "/ridge/north/capture": {"listeners.pose": "2", "queue": "9"},
        "/ridge/x": {"listeners./ridge/map": "1"},
    }
    assert unmatched(node, summaries) == ["/ridge/north/pose"]
