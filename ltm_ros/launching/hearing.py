"""Judges by what the processes of a graph say that they have sent and heard whether one of them hears nothing on DDS.

Such a process lives, reports and waits for work, so nothing else shows it. Only its runner knows of both sides, and not
by DDS.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping

LEAST_MISSED = 10
"""Messages that a process must have missed: one or two may be lost."""


class GraphTraffic:
    """What each process has sent, by topic, however often it was started anew; for all supervisors, from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: dict[str, dict[str, int]] = {}
        """What each has said of its present run,"""
        self._ever: dict[str, dict[str, int]] = {}
        """and of all its runs together."""

    def begin(self, process: str) -> None:
        """A process has been started: it counts from 0."""
        with self._lock:
            self._last[process] = {}

    def take(self, process: str, said: Mapping[str, int]) -> None:
        with self._lock:
            last, ever = self._last.setdefault(process, {}), self._ever.setdefault(process, {})
            for topic, count in said.items():
                # Of a publisher that was made anew within the process, its first messages may be missing here.
                ever[topic] = ever.get(topic, 0) + max(0, count - last.get(topic, 0))
            self._last[process] = dict(said)

    def of_others(self, process: str, topics: Iterable[str]) -> dict[str, int]:
        """Messages that other processes than this have sent on each of these topics."""
        with self._lock:
            others = [ever for name, ever in self._ever.items() if name != process]
            return {topic: sum(ever.get(topic, 0) for ever in others) for topic in topics}


class HearingWatch:
    """Of one run of a process: that it hears nothing of what the others send on any of its topics. One that hears
    anything, whoever sent it, hears.

    Args:
        patience_s: for which it must have heard nothing, from the first message on that it missed.
    """

    def __init__(self, process: str, traffic: GraphTraffic, patience_s: float) -> None:
        self._process, self._traffic, self._patience_s = process, traffic, patience_s
        self.heard = 0
        """Messages, on all topics."""
        self.deaf = False
        """Whether `look` has found it so."""
        self._before: dict[str, int] = {}
        """What others had sent on each topic when it was last heard to hear, or began to listen."""
        self._deaf_s = 0.0

    def begin_anew(self) -> None:
        """What it has missed until now does not count: it starts, or the watch itself lay still."""
        self._before, self._deaf_s = {}, 0.0

    def take(self, said: Mapping[str, int]) -> None:
        """What this process has sent: others must have heard it."""
        self._traffic.take(self._process, said)

    def look(self, elapsed_s: float, heard: Mapping[str, int]) -> str:
        """What is wrong, in words, or nothing. `heard`: as the process has just said."""
        total = sum(heard.values())
        if total != self.heard:
            self.heard = total
            self.begin_anew()
        sent = self._traffic.of_others(self._process, heard)
        missed = {topic: count - self._before.setdefault(topic, count) for topic, count in sent.items()}
        total_missed = sum(missed.values())
        self._deaf_s = self._deaf_s + elapsed_s if total_missed else 0.0
        if self._deaf_s <= self._patience_s or total_missed < LEAST_MISSED:
            return ""
        self.deaf = True
        most = max(missed, key=missed.__getitem__)
        return f"it has heard none of {total_missed} messages in {self._deaf_s:.0f} s, most of them on {most}"
