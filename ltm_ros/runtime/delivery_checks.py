"""Count messages sent, received and lost, and check that publishers and subscribers are matched.

Check that publishers and subscribers are matched, and count lost messages.

Counts messages of a topic that were sent but never received, from the sequence numbers of the middleware.

A reader keeps the newest few messages of a topic: what a slow process does not take in time is replaced by the next,
and nothing reports it. The same holds for messages for which shared memory had no room, and for bytes that are no
message. Only a gap in the sequence numbers shows it.
"""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypedDict

from rclpy.node import Node


class TrafficCounts(TypedDict):
    """Messages since the process began, by absolute topic."""

    said: dict[str, int]
    heard: dict[str, int]


class TopicCount:
    """Of one publisher or subscription; counted up by one thread at a time."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.messages = 0


class Traffic:
    """Of one process; from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._said: list[TopicCount] = []
        self._heard: list[TopicCount] = []

    def speaker(self, topic: str) -> TopicCount:
        """For a publisher. Not of latched topics: what they last said is heard by those who come later, too."""
        return self._add(self._said, topic)

    def listener(self, topic: str) -> TopicCount:
        """For a subscription."""
        return self._add(self._heard, topic)

    def forget(self, counts: Iterable[TopicCount]) -> None:
        """These publishers and subscriptions are gone."""
        gone = set(counts)
        with self._lock:
            self._said[:] = [count for count in self._said if count not in gone]
            self._heard[:] = [count for count in self._heard if count not in gone]

    def counts(self) -> TrafficCounts | None:
        """None where the process has neither publishers nor subscriptions that are counted."""
        with self._lock:
            said, heard = list(self._said), list(self._heard)
        return {"said": _by_topic(said), "heard": _by_topic(heard)} if said or heard else None

    def _add(self, counts: list[TopicCount], topic: str) -> TopicCount:
        with self._lock:
            counts.append(made := TopicCount(topic))
        return made


def _by_topic(counts: list[TopicCount]) -> dict[str, int]:
    found: dict[str, int] = {}
    for count in counts:
        found[count.topic] = found.get(count.topic, 0) + count.messages
    return found


TRAFFIC = Traffic()
"""That of this process."""


def with_info(take: Callable[[Any, Any], None]) -> Callable[..., None]:
    """`take` as `create_subscription` shall have it.

    rclpy finds out from a callback's signature whether it wants the info, and calls it with both; its EventsExecutor,
    as of 7.1, with one tuple of both.
    """

    def callback(*given: Any) -> None:
        message, info = given if len(given) == 2 else given[0]
        take(message, info)

    callback.__signature__ = inspect.signature(lambda message, info: None)  # type: ignore[attr-defined]
    return callback


NUMBER = "publication_sequence_number"
UNKNOWN = 2**64 - 1
"""What a middleware says that does not number messages."""

Writers = Callable[[], frozenset[bytes]]
"""The identities of those that publish on the topic now."""


class LossCounter:
    """Of one topic. Only counts while one and the same writer publishes: several count each for themselves."""

    def __init__(self, writers: Writers) -> None:
        self._writers = writers
        self._writer: frozenset[bytes] = frozenset()
        self._last = 0

    def lost(self, info: Mapping[str, Any]) -> int:
        """How many messages are missing between the last one and the one with this `info` of rclpy's."""
        number, last = int(info.get(NUMBER) or UNKNOWN), self._last
        if number == UNKNOWN:
            return 0
        self._last = number
        # Asking costs: only when the numbers leap is it known whether they still are the same writer's.
        if number == last + 1 and last:
            return 0
        former, self._writer = self._writer, self._writers()
        return max(0, number - last - 1) if last and len(former) == 1 and former == self._writer else 0


def loss_report(lost: int, topic: str) -> str:
    """Value and remedy, as `Health.drop` takes them."""
    return (
        f"{lost} messages of {topic} did not come through: this node was too slow to take them (slow the camera down, "
        "give it more cores), /dev/shm was full, or they were no messages"
    )


def writers_of(node: Any, topic: str) -> Writers:
    """As `LossCounter` takes it; `topic` as given to `create_subscription`."""
    return lambda: frozenset(bytes(end.endpoint_gid) for end in node.get_publishers_info_by_topic(topic))


LISTENERS = "listeners."
"""Prefix of the diagnostics key that holds how many subscribers a node's publisher is matched with."""


def unmatched(node: Node, summaries: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Topics that have more subscribers than their publisher is matched with, or the other way round.

    DDS discovers each pair of processes by itself: that `node` knows of two others says nothing of what these know of
    each other. So their own word counts, `summaries`: the latest diagnostics of every node, by full name. Listeners
    that are none of these, somebody's `ros2 topic echo`, are waited for by nobody.
    """
    found = []
    for name, summary in summaries.items():
        namespace = name.rpartition("/")[0]
        for key, value in summary.items():
            if key.startswith(LISTENERS):
                topic = key.removeprefix(LISTENERS)
                topic = topic if topic.startswith("/") else f"{namespace}/{topic}"
                listeners = [
                    f"{end.node_namespace.rstrip('/')}/{end.node_name}"
                    for end in node.get_subscriptions_info_by_topic(topic)
                ]
                # One whose name is not yet known may be anybody's.
                ours = sum(listener in summaries or "_UNKNOWN_" in listener for listener in listeners)
                matched = int(value)
                if matched < ours or (matched != ours and ours == len(listeners)):
                    found.append(topic)
    return found


def unheard(node: Node) -> dict[str, str]:
    """Topics of a node's own subscriptions that more publish on than it is matched with: what is wrong, with a remedy.

    For a moment after somebody comes or goes that is as it should be.
    """
    found = {}
    for subscription in node.subscriptions:
        topic = subscription.topic_name
        known, matched = node.count_publishers(topic), subscription.get_publisher_count()
        if matched < known:
            found[topic] = (
                f"{known} publish {topic}, {matched} reach this node; let them offer what it asks for (reliable, and "
                "transient local where it is latched), or restart it"
            )
    return found
