"""Read this machine's clocks, whether they are synchronised, and when they are set."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

_TIME_ERROR = 5
"""What adjtimex(2) returns while nothing keeps the clock right."""


class _Timex(ctypes.Structure):
    """`struct timex` of Linux on machines with 64 bits; `modes` = 0 only asks."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        *((name, ctypes.c_long) for name in ("offset", "freq", "maxerror", "esterror")),
        ("rest", ctypes.c_byte * 168),
    )


@dataclass(frozen=True)
class KernelClock:
    synchronised: bool | None
    """Whether something keeps the clock right (chrony, ntpd and systemd-timesyncd tell the kernel); None: not known."""
    estimated_error_s: float | None


def kernel_clock() -> KernelClock:
    adjtimex = getattr(ctypes.CDLL(None), "adjtimex", None)
    asked = _Timex()
    state = -1 if adjtimex is None else int(adjtimex(ctypes.byref(asked)))
    if state < 0:
        return KernelClock(None, None)
    synchronised = state != _TIME_ERROR
    return KernelClock(synchronised, asked.esterror / 1e6 if synchronised else None)


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


class Clock(Protocol):
    """Time of day and time that no one sets, both in seconds."""

    def wall(self) -> float: ...

    def monotonic(self) -> float: ...

    def synchronised(self) -> bool | None:
        """None: not known."""
        ...


class SystemClock:
    def wall(self) -> float:
        return time.time()

    def monotonic(self) -> float:
        return time.monotonic()

    def synchronised(self) -> bool | None:
        return kernel_clock().synchronised
