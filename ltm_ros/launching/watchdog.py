"""Decide from heartbeats and traffic counts whether the processes of a graph work.

A process that receives nothing over DDS still runs, reports and waits, so only a comparison of sent and received counts
shows it. Only the runner has both, and not over DDS."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ltm_core.site.sections import WatchdogConfig

LEAST_MISSED = 10
"""Minimum number of missed messages: one or two may be lost."""


class GraphTraffic:
    """Messages sent by each process, by topic, over all its restarts; for all supervisors, thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: dict[str, dict[str, int]] = {}
        """Counts of each process in its current run,"""
        self._ever: dict[str, dict[str, int]] = {}
        """and in all its runs together."""

    def begin(self, process: str) -> None:
        """Start counting a new run from 0."""
        with self._lock:
            self._last[process] = {}

    def take(self, process: str, said: Mapping[str, int]) -> None:
        with self._lock:
            last, ever = self._last.setdefault(process, {}), self._ever.setdefault(process, {})
            for topic, count in said.items():
                # If a publisher was recreated within the process, its first messages may be missing here.
                ever[topic] = ever.get(topic, 0) + max(0, count - last.get(topic, 0))
            self._last[process] = dict(said)

    def of_others(self, process: str, topics: Iterable[str]) -> dict[str, int]:
        """Return the messages that other processes have sent on each of these topics."""
        with self._lock:
            others = [ever for name, ever in self._ever.items() if name != process]
            return {topic: sum(ever.get(topic, 0) for ever in others) for topic in topics}


class HearingWatch:
    """Detects that one run of a process receives nothing from the others on any topic. `patience_s`: seconds without
    any message, from the first missed message on."""

    def __init__(self, process: str, traffic: GraphTraffic, patience_s: float) -> None:
        self._process, self._traffic, self._patience_s = process, traffic, patience_s
        self.heard = 0
        """Messages received on all topics."""
        self.deaf = False
        """Whether `look` has found that it receives nothing."""
        self._before: dict[str, int] = {}
        """Messages sent by others on each topic when this process last received one, or subscribed."""
        self._deaf_s = 0.0

    def begin_anew(self) -> None:
        """Ignore earlier missed messages: the process starts, or the watchdog itself was paused."""
        self._before, self._deaf_s = {}, 0.0

    def take(self, said: Mapping[str, int]) -> None:
        """Record what this process has sent."""
        self._traffic.take(self._process, said)

    def look(self, elapsed_s: float, heard: Mapping[str, int]) -> str:
        """Return what is wrong, in words, or nothing. `heard`: counts that the process has just reported."""
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
        return f"received 0 of {total_missed} messages in {self._deaf_s:.0f} s, most of them on {most}"


BUSY = 0.05
"""Share of a core above which a silent process counts as computing in code that holds Python's lock."""
WAITING = ("R", "D")
"""Process states in which it waits for a core or a disk: no sign of a hang."""
INTERRUPTED_S = 5.0
"""Seconds between two checks (normally one) after which the watchdog itself was paused."""
PARDON_S = 5.0
"""Seconds after such a pause in which no process is judged: others may have waited for the runner."""


@dataclass(frozen=True)
class ProcessUse:
    """State of a process as in `ps` (`T`: stopped), and its processor time."""

    state: str
    cpu_s: float


def process_use(pid: int) -> ProcessUse:
    """Read it from /proc; a dead process has used nothing. Uses bytes for names, because pathlib interns each part of a
    path, every second for months."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:  # noqa: PTH123 # as above
            fields = file.read().rpartition(b")")[2].split()
    except OSError:
        return ProcessUse("gone", 0.0)
    return ProcessUse(fields[0].decode("ascii"), (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"))


class HangWatch:
    """Detects that one run of a process hangs. `slow_starts`: consecutive starts that were ended as too slow; each
    doubles this run's limit. `hearing`: of this run; None: received messages are not checked."""

    def __init__(self, limits: WatchdogConfig, slow_starts: int = 0, hearing: HearingWatch | None = None) -> None:
        self._limits, self._hearing = limits, hearing
        self._start_s = limits.slow * 2.0 ** min(slow_starts, 10)
        self.started = False
        """Whether the process has reported that it is running."""
        self._begun_s = 0.0
        self._silent_s = 0.0
        self._idle_s = 0.0
        self._pardon_s = 0.0
        self._cpu_s = 0.0
        self._heard = False
        self._rest = b""
        self.ready: frozenset[str] = frozenset()
        """Full names of the nodes that have sent a diagnostic."""
        self._beat: list[tuple[float, bool, str]] = []
        self._topics_heard: dict[str, int] | None = None
        """Messages by topic, if the process has just reported them."""
        self._unlooked_s = 0.0
        """Seconds since `hearing` was checked."""

    def look(self, elapsed_s: float, heard: bytes, use: ProcessUse) -> str:
        """Return what hangs, in words, or nothing. `heard`: heartbeats since the last call."""
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
        """Return why it counts as receiving nothing, after it has reported its counts."""
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
            return f"not started within {self._begun_s:.0f} s"
        stopped = ", it is stopped (SIGSTOP)" if use.state == "T" else ""
        if self._heard and self._idle_s > limits.silent:
            return f"no heartbeat for {self._idle_s:.0f} s{stopped}"
        if self._silent_s > limits.stuck:
            computes = ", although it is computing or waiting for a core" if self._idle_s < self._silent_s else ""
            return f"no heartbeat for {self._silent_s:.0f} s{stopped or computes}"
        for age_s, slow, what in self._beat if self.started else ():
            if age_s > (limits.slow if slow else limits.stuck):
                return f"{what} has not finished in {age_s:.0f} s"
        return ""

    def _take(self, heard: bytes) -> None:
        *lines, self._rest = (self._rest + heard).split(b"\n")
        self._heard = self._heard or bool(lines)
        for told in map(json.loads, lines[-1:]):
            if self._hearing is not None:
                self._hearing.take(told["said"])
            self._topics_heard = told["heard"]
            self._beat = [(float(age), bool(slow), str(what)) for age, slow, what in told["activities"]]
            self.ready = frozenset(told["ready"])
            self.started = self.started or not any(what.startswith("start:") for _, _, what in self._beat)
