import itertools
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="the ROS extra is not installed")

from ltm_ros.runtime.delivery_checks import NUMBER, LossCounter, unheard, unmatched
from ltm_ros.runtime.health import Health


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

    def count_publishers(self, topic: str) -> int:
        return 3 if topic == "/diagnostics" else 1


def test_a_publisher_that_is_known_and_not_matched_is_not_heard() -> None:
    node: Any = Graph({"/pose": 2, "/image": 1, "/clock": 0}, pose=1, image=1, clock=0)
    assert list(unheard(node)) == ["/pose"]
    assert "1 of 2 publishers" in unheard(node)["/pose"]


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


@pytest.mark.parametrize(("discovered", "loose"), [("2", ["/ridge/recorder"]), ("3", []), ("4", [])])
def test_a_recorder_that_has_not_found_a_process_lacks_its_topics(discovered: str, loose: list[str]) -> None:
    """DDS finds each pair of processes separately: the player may know a camera's node for seconds before the recorder
    does, which then subscribes to nothing of it."""
    node: Any = Heard()
    assert unmatched(node, {"/ridge/recorder": {"discovered": discovered}, "/ridge/north/capture": {}}) == loose


class Topic:
    """A topic with its writers, and a counter that listens to it."""

    def __init__(self, *writers: bytes) -> None:
        self.writers, self.health = writers, Health()
        self.counter = LossCounter(self, "/pose", self.health)

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return [SimpleNamespace(endpoint_gid=writer) for writer in self.writers]

    def lost(self, *numbers: int | None) -> list[int]:
        counts = [self.health.dropped.get("lost", 0)]
        for number in numbers:
            self.counter.take({} if number is None else {NUMBER: number})
            counts.append(self.health.dropped.get("lost", 0))
        return [after - before for before, after in itertools.pairwise(counts)]


def test_counts_what_is_passed_over_but_not_what_was_sent_before_the_first() -> None:
    assert Topic(b"a").lost(41, 42, 43, 47, 48, 50) == [0, 0, 0, 3, 0, 1]


@pytest.mark.parametrize("first_of_the_next", [1, 4, 90])
def test_a_writer_that_comes_back_counts_anew(first_of_the_next: int) -> None:
    topic = Topic(b"a")
    assert topic.lost(1, 2, 3, 4, 5) == [0] * 5
    topic.writers = (b"b",)
    second = first_of_the_next + 1
    assert topic.lost(first_of_the_next, second, second + 3) == [0, 0, 2]
