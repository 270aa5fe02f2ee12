"""Read this machine's clocks, and detect whether they are synchronised and when they are set."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

_TIME_ERROR = 5
"""Result of adjtimex(2) while the clock is not synchronised."""


class _Timex(ctypes.Structure):
    """`struct timex` of 64-bit Linux; `modes` = 0 only reads."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        *((name, ctypes.c_long) for name in ("offset", "freq", "maxerror", "esterror")),
        ("rest", ctypes.c_byte * 168),
    )


@dataclass(frozen=True)
class KernelClock:
    synchronised: bool | None
    """Whether a time service synchronises the clock (chrony, ntpd or systemd-timesyncd report it to the kernel); None:
    unknown."""
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
"""Smallest clock step in seconds; gradual corrections by a time service stay far below it."""
_INTERRUPTED_NS = 100_000_000


def _elapsed_ns() -> int:
    """Return the nanoseconds since the machine started, including suspend, so that waking up is no step."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class ClockWatch:
    """Compares the system clock with a monotonic one. Tests pass their own clocks."""

    def __init__(self, wall_ns: Callable[[], int] = time.time_ns, elapsed_ns: Callable[[], int] = _elapsed_ns) -> None:
        self._wall_ns, self._elapsed_ns = wall_ns, elapsed_ns
        self._offset: int | None = None
        self.step_s()

    def step_s(self) -> float:
        """Return the seconds by which the clock was set since the last call, negative if set back; 0.0
        without a step."""
        before = self._elapsed_ns()
        wall = self._wall_ns()
        if self._elapsed_ns() - before > _INTERRUPTED_NS:
            return 0.0  # the process was paused between the two: the next call decides
        former, offset = self._offset, wall - before
        step = 0.0 if former is None else (offset - former) / 1e9
        if former is None or abs(step) < LEAST_STEP_S:
            self._offset = offset if former is None else former
            return 0.0
        self._offset = offset
        return step


class Clock(Protocol):
    """System time and monotonic time, both in seconds."""

    def wall(self) -> float: ...

    def monotonic(self) -> float: ...

    def synchronised(self) -> bool | None:
        """Return whether the clock is synchronised; None: unknown."""
        ...


class SystemClock:
    def wall(self) -> float:
        return time.time()

    def monotonic(self) -> float:
        return time.monotonic()

    def synchronised(self) -> bool | None:
        return kernel_clock().synchronised
