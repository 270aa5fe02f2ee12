"""Counts what this process has sent to others on DDS and what it has heard there, by topic: its runner compares that
with what the other processes have, and so notices one that hears nothing. Standard library only.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import TypedDict


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
