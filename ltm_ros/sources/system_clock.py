"""This computer's clocks, and whether the time of day is synchronised (NTP, PTP, satellites)."""

from __future__ import annotations

import time
from typing import Protocol

from ltm_ros.runtime.kernel_clock import kernel_clock


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
