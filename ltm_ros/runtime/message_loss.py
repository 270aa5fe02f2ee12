"""Counts messages of a topic that were sent but never received, from the sequence numbers of the middleware.

A reader keeps the newest few messages of a topic: what a slow process does not take in time is replaced by the next,
and nothing reports it. The same holds for messages for which shared memory had no room, and for bytes that are no
message. Only a gap in the sequence numbers shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

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
