"""Count what this process has sent to others and received from them."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import TypedDict


class TrafficCounts(TypedDict):
    """Messages since the start of the process, by absolute topic."""

    said: dict[str, int]
    heard: dict[str, int]


class TopicCount:
    """Count of one publisher or subscription; written by one thread at a time."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.messages = 0


class Traffic:
    """Counts of one process; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._said: list[TopicCount] = []
        self._heard: list[TopicCount] = []

    def speaker(self, topic: str) -> TopicCount:
        """Return the count of a publisher. Latched topics are not counted, because later subscribers get their last
        message, too.
        """
        return self._add(self._said, topic)

    def listener(self, topic: str) -> TopicCount:
        """Return the count of a subscription."""
        return self._add(self._heard, topic)

    def forget(self, counts: Iterable[TopicCount]) -> None:
        """Remove these publishers and subscriptions."""
        gone = set(counts)
        with self._lock:
            self._said[:] = [count for count in self._said if count not in gone]
            self._heard[:] = [count for count in self._heard if count not in gone]

    def counts(self) -> TrafficCounts | None:
        """Return the counts; None if the process has no counted publishers or subscriptions."""
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
"""Traffic of this process."""
