"""This computer's clocks, and whether the time of day is synchronised (NTP, PTP, satellites)."""

from __future__ import annotations

import ctypes
import time
from typing import Protocol

TIME_ERROR = 5
"""Of `adjtimex`: the clock is not synchronised. Source: adjtimex(2)."""


class Clock(Protocol):
    """Time of day and time that no one sets, both in seconds."""

    def wall(self) -> float: ...

    def monotonic(self) -> float: ...

    def synchronised(self) -> bool | None:
        """None: not known."""
        ...


class _Timex(ctypes.Structure):
    """`struct timex` of Linux on 64 bits: as large as it is there; nothing of it is read."""

    _fields_ = (("modes", ctypes.c_uint), ("rest", ctypes.c_byte * 204))


class SystemClock:
    def __init__(self) -> None:
        library = ctypes.CDLL(None, use_errno=True)
        self._adjtimex = getattr(library, "adjtimex", None)

    def wall(self) -> float:
        return time.time()

    def monotonic(self) -> float:
        return time.monotonic()

    def synchronised(self) -> bool | None:
        """As the kernel says, which chrony, ntpd and systemd-timesyncd tell. Asks only: needs no right."""
        if self._adjtimex is None:
            return None
        state = int(self._adjtimex(ctypes.byref(_Timex())))
        return None if state < 0 else state != TIME_ERROR
