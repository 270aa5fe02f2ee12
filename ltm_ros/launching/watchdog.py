"""Judge by heartbeats and reports whether the processes of a graph work.

Judges by what the processes of a graph say that they have sent and heard whether one of them hears nothing on DDS.

Such a process lives, reports and waits for work, so nothing else shows it. Only its runner knows of both sides, and not
by DDS.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ltm_core.site.sections import WatchdogConfig

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


BUSY = 0.05
"""Share of a core from which a process that says nothing is taken to compute, in code that holds Python's lock."""
WAITING = ("R", "D")
"""States in which a process would go on if it had a core, or its disk answered: no sign that it hangs."""
INTERRUPTED_S = 5.0
"""Between two looks, which come once a second: then the watch itself lay still (the runner was stopped)."""
PARDON_S = 5.0
"""For which nobody is judged after that: others may have waited for the runner."""


@dataclass(frozen=True)
class ProcessUse:
    """State of a process as `ps` has it (`T`: stopped), and the processor time that it has used."""

    state: str
    cpu_s: float


def process_use(pid: int) -> ProcessUse:
    """Of /proc; a process that is gone has used nothing.

    By name, and in bytes: pathlib keeps each part of a path among Python's interned strings, whose table takes fresh
    memory for each that comes and goes. This is asked each second, of every process, for months.
    """
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:  # noqa: PTH123 # as above
            fields = file.read().rpartition(b")")[2].split()
    except OSError:
        return ProcessUse("gone", 0.0)
    return ProcessUse(fields[0].decode("ascii"), (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"))


class HangWatch:
    """Of one run of a process. Time is what the caller says has passed between looks, so no clock can mislead it.

    Args:
        limits: of the site.
        slow_starts: starts in a row that were ended as too slow; each doubles the time that this one has.
        hearing: of this run; None: whether it hears anything on DDS is not looked at.
    """

    def __init__(self, limits: WatchdogConfig, slow_starts: int = 0, hearing: HearingWatch | None = None) -> None:
        self._limits, self._hearing = limits, hearing
        self._start_s = limits.slow * 2.0 ** min(slow_starts, 10)
        self.started = False
        """Whether the process has said that it is at work."""
        self._begun_s = 0.0
        self._silent_s = 0.0
        self._idle_s = 0.0
        self._pardon_s = 0.0
        self._cpu_s = 0.0
        self._heard = False
        self._rest = b""
        self._beat: list[tuple[float, bool, str]] = []
        self._topics_heard: dict[str, int] | None = None
        """Messages by topic, where the process has just told of them."""
        self._unlooked_s = 0.0
        """Since `hearing` was looked at."""

    def look(self, elapsed_s: float, heard: bytes, use: ProcessUse) -> str:
        """What hangs, in words, or nothing. `heard`: what has come on the heartbeat's pipe since the last look."""
        self._take(heard)
        cpu_s, self._cpu_s = use.cpu_s - self._cpu_s, use.cpu_s
        if elapsed_s > INTERRUPTED_S:
            self._silent_s = self._idle_s = 0.0
            self._pardon_s = PARDON_S
            self._topics_heard = None
            if self._hearing is not None:
                self._hearing.begin_anew()
            return ""
        self._begun_s += elapsed_s
        self._silent_s = 0.0 if heard else self._silent_s + elapsed_s
        works = cpu_s > BUSY * elapsed_s or use.state in WAITING
        self._idle_s = 0.0 if heard or works else self._idle_s + elapsed_s
        self._pardon_s -= elapsed_s
        deaf = self._listen(elapsed_s)
        return "" if self._pardon_s > 0 else self._verdict(use) or deaf

    def _listen(self, elapsed_s: float) -> str:
        """Why it is taken to hear nothing, when it has just told what it has heard."""
        self._unlooked_s += elapsed_s
        heard, self._topics_heard = self._topics_heard, None
        if self._hearing is None or heard is None:
            return ""
        if not self.started:
            self._hearing.begin_anew()
        elapsed_s, self._unlooked_s = self._unlooked_s, 0.0
        return self._hearing.look(elapsed_s, heard)

    def _verdict(self, use: ProcessUse) -> str:
        limits = self._limits
        if not self.started and self._begun_s > self._start_s:
            return f"it has not started in {self._begun_s:.0f} s"
        stopped = ", it is stopped (SIGSTOP)" if use.state == "T" else ""
        if self._heard and self._idle_s > limits.silent:
            return f"no sign of life for {self._idle_s:.0f} s{stopped}"
        if self._silent_s > limits.stuck:
            computes = ", though it is at work or waits for it" if self._idle_s < self._silent_s else ""
            return f"no sign of life for {self._silent_s:.0f} s{stopped or computes}"
        for age_s, slow, what in self._beat if self.started else ():
            if age_s > (limits.slow if slow else limits.stuck):
                return f"{what} has not come to an end in {age_s:.0f} s"
        return ""

    def _take(self, heard: bytes) -> None:
        *lines, self._rest = (self._rest + heard).split(b"\n")
        self._heard = self._heard or bool(lines)
        for told in map(json.loads, lines[-2:]):  # the newest of either kind, where a process tells both
            if isinstance(told, dict):
                if self._hearing is not None:
                    self._hearing.take(told["said"])
                self._topics_heard = told["heard"]
            else:
                self._beat = [(float(age), bool(slow), str(what)) for age, slow, what in told]
                self.started = self.started or not any(what.startswith("start:") for _, _, what in self._beat)
