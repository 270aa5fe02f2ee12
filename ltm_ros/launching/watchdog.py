"""Decide from heartbeats and processor time whether the processes of a graph work."""

import json
import os

from ltm_core.site.sections import WatchdogConfig

BUSY = 0.05
"""Share of a core above which a silent process counts as computing in code that holds Python's lock."""
WAITING = ("R", "D")
"""Process states in which it waits for a core or a disk: no sign of a hang."""
INTERRUPTED_S = 5.0
"""Seconds between two checks (normally one) after which the watchdog itself was paused."""
PARDON_S = 5.0
"""Seconds after such a pause in which no process is judged: others may have waited for the runner."""


def process_use(pid: int) -> tuple[str, float]:
    """Return the state of a process as in `ps` (`T`: stopped), and its processor time in seconds; a dead one has used
    nothing. Uses bytes for names, because pathlib interns each part of a path, every second for months."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:  # noqa: PTH123 # as above
            fields = file.read().rpartition(b")")[2].split()
    except OSError:
        return "gone", 0.0
    return fields[0].decode("ascii"), (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class HangWatch:
    """Detects that one run of a process hangs. `slow_starts`: consecutive starts that were ended as too slow; each
    doubles this run's limit."""

    def __init__(self, limits: WatchdogConfig, slow_starts: int = 0) -> None:
        self._limits = limits
        self._start_s = limits.slow * 2.0 ** min(slow_starts, 10)
        self.started = False
        """Whether the process has reported that it is running."""
        self.ready: frozenset[str] = frozenset()
        """Full names of the nodes that have sent a diagnostic."""
        self._begun_s = self._silent_s = self._idle_s = self._pardon_s = self._cpu_s = 0.0
        self._heard = False
        self._rest = b""
        self._beat: list[tuple[float, bool, str]] = []

    def look(self, elapsed_s: float, heard: bytes, use: tuple[str, float]) -> str:
        """Return what hangs, in words, or nothing. `heard`: heartbeats since the last call; `use`: of `process_use`."""
        self._take(heard)
        state, used_s = use
        cpu_s, self._cpu_s = used_s - self._cpu_s, used_s
        if elapsed_s > INTERRUPTED_S:
            self._silent_s = self._idle_s = 0.0
            self._pardon_s = PARDON_S
            return ""
        self._begun_s += elapsed_s
        self._silent_s = 0.0 if heard else self._silent_s + elapsed_s
        works = cpu_s > BUSY * elapsed_s or state in WAITING
        self._idle_s = 0.0 if heard or works else self._idle_s + elapsed_s
        self._pardon_s -= elapsed_s
        return "" if self._pardon_s > 0 else self._verdict(state)

    def _verdict(self, state: str) -> str:
        limits = self._limits
        if not self.started and self._begun_s > self._start_s:
            return f"not started within {self._begun_s:.0f} s"
        stopped = ", it is stopped (SIGSTOP)" if state == "T" else ""
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
            self._beat = [(float(age), bool(slow), str(what)) for age, slow, what in told["activities"]]
            self.ready = frozenset(told["ready"])
            self.started = self.started or not any(what.startswith("start:") for _, _, what in self._beat)
