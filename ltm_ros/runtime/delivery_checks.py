"""Publish diagnostics, count messages sent, received and lost, and check that all publishers are matched.

Lost messages are counted from gaps in the middleware's sequence numbers. A reader keeps only the newest messages of a
topic: what a slow process does not take in time is replaced without notice. The same holds for messages that did not
fit into shared memory, and for invalid bytes."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ltm_msgs_py.status import status_message
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.heartbeat import HEARTBEAT


def with_info(take: Callable[[Any, Any], None]) -> Callable[..., None]:
    """Return `take` in the form that `create_subscription` needs.

    rclpy decides by a callback's signature whether it passes the message info, as second argument; its EventsExecutor
    (7.1) passes one tuple of both."""

    def callback(*given: Any) -> None:
        message, info = given if len(given) == 2 else given[0]
        take(message, info)

    callback.__signature__ = inspect.signature(lambda message, info: None)  # type: ignore[attr-defined]
    return callback


NUMBER = "publication_sequence_number"
UNKNOWN = 2**64 - 1
"""Sequence number of a middleware that does not number messages."""


class LossCounter:
    """Counts lost messages of one topic, only while there is a single publisher, because each numbers its own messages.

    `topic`: as `node` gives it to `create_subscription`. `health`: counts them as `lost`."""

    def __init__(self, node: Node, topic: str, health: Health) -> None:
        self._node, self._topic, self._health = node, topic, health
        self._writers: frozenset[bytes] = frozenset()
        self._last = 0

    def take(self, info: Mapping[str, Any]) -> None:
        """Count the messages missing between the last one and the one with this rclpy `info`."""
        number, last = int(info.get(NUMBER) or UNKNOWN), self._last
        if number == UNKNOWN:
            return
        self._last = number
        # The query is expensive: only a gap in the numbers requires a check that the publisher is the same.
        if number == last + 1 and last:
            return
        ends = self._node.get_publishers_info_by_topic(self._topic)
        former, self._writers = self._writers, frozenset(bytes(end.endpoint_gid) for end in ends)
        lost = number - last - 1
        if lost > 0 and last and len(former) == 1 and former == self._writers:
            why = "this node was too slow (reduce the frame rate or add cores), /dev/shm was full, or they were invalid"
            self._health.drop("lost", f"{lost} messages of {self._topic} were lost: {why}", lost)


LISTENERS = "listeners."
"""Prefix of the diagnostics key with the number of subscribers that a publisher is matched with."""


def unmatched(node: Node, summaries: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return topics whose publisher is not matched with all subscribers, or the reverse, and nodes that have not
    discovered all others, so that their subscriptions are still missing.

    DDS discovers each pair of processes separately: `node` cannot see whether two others are matched. So this uses
    their own reports, `summaries`: the latest diagnostics of every node, by full name. Other subscribers, such as `ros2
    topic echo`, are ignored."""
    found = []
    reporting = node.count_publishers("/diagnostics")
    for name, summary in summaries.items():
        # The recorder's number of these publishers, which processes open last, when it last subscribed to topics.
        if int(summary.get("discovered", reporting)) < reporting:
            found.append(name)
        namespace = name.rpartition("/")[0]
        for key, value in summary.items():
            if not key.startswith(LISTENERS):
                continue
            topic = key.removeprefix(LISTENERS)
            topic = topic if topic.startswith("/") else f"{namespace}/{topic}"
            ends = node.get_subscriptions_info_by_topic(topic)
            listeners = [f"{end.node_namespace.rstrip('/')}/{end.node_name}" for end in ends]
            # One whose name is unknown yet may be any node.
            ours, matched = sum(one in summaries or "_UNKNOWN_" in one for one in listeners), int(value)
            if matched < ours or (matched != ours and ours == len(listeners)):
                found.append(topic)
    return found


def unheard(node: Node) -> dict[str, str]:
    """Return the problem and remedy of each subscription with more publishers than matches.

    This is normal for a moment after a node starts or ends."""
    found = {}
    for subscription in node.subscriptions:
        topic = subscription.topic_name
        known, matched = node.count_publishers(topic), subscription.get_publisher_count()
        if matched < known:
            found[topic] = (
                f"{topic}: this node is matched with {matched} of {known} publishers; use matching QoS "
                "(reliable, and transient local for latched topics), or restart it"
            )
    return found


class DiagnosticsPublisher:
    """Publishes on a steady clock, because diagnostics must continue when a replay's ROS time stops.

    `healths`: of the nodes that `node` reports for, by full name. `others`: returns further statuses."""

    def __init__(
        self,
        node: Node,
        healths: Mapping[str, Health],
        hardware_id: str = "",
        others: Callable[[], list[DiagnosticStatus]] = list,
    ) -> None:
        self._node, self._healths, self._hardware_id, self._others = node, healths, hardware_id, others
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        node.create_timer(1.0, self.publish, clock=self.steady_clock())

    @staticmethod
    def steady_clock() -> Clock:
        return Clock(clock_type=ClockType.STEADY_TIME)

    def publish(self) -> None:
        array = DiagnosticArray(status=[self._status(name, health) for name, health in self._healths.items()])
        array.status.extend(self._others())
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
        HEARTBEAT.ready(self._healths)

    def _status(self, name: str, health: Health) -> DiagnosticStatus:
        level = DiagnosticStatus.WARN if health.troubled else DiagnosticStatus.OK
        return status_message(name, level, health.message, health.summary(), self._hardware_id)
