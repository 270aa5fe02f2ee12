"""Notices when the machine's clock is set while a node runs."""

from __future__ import annotations

import time
from collections.abc import Callable

LEAST_STEP_S = 1.0
"""What a time service corrects by running the clock faster or slower stays far below it."""
_INTERRUPTED_NS = 100_000_000


def _elapsed_ns() -> int:
    """Nanoseconds since the machine started, those that it slept among them: waking up is no step."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class ClockWatch:
    """Compares the clock on the wall with one that nobody can set. The two clocks are arguments for tests."""

    def __init__(self, wall_ns: Callable[[], int] = time.time_ns, elapsed_ns: Callable[[], int] = _elapsed_ns) -> None:
        self._wall_ns, self._elapsed_ns = wall_ns, elapsed_ns
        self._offset: int | None = None
        self.step_s()

    def step_s(self) -> float:
        """Seconds by which the clock was set since the last call, less than none: back; 0.0 where it was not."""
        before = self._elapsed_ns()
        wall = self._wall_ns()
        if self._elapsed_ns() - before > _INTERRUPTED_NS:
            return 0.0  # the process lay still between the two: the next call will tell
        former, offset = self._offset, wall - before
        step = 0.0 if former is None else (offset - former) / 1e9
        if former is None or abs(step) < LEAST_STEP_S:
            self._offset = offset if former is None else former
            return 0.0
        self._offset = offset
        return step
