"""Read this machine's clocks, and whether they are synchronised."""

import ctypes
import time
from dataclasses import dataclass

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


class SystemClock:
    """System time and monotonic time, both in seconds."""

    def wall(self) -> float:
        return time.time()

    def monotonic(self) -> float:
        return time.monotonic()

    def synchronised(self) -> bool | None:
        """Return whether the clock is synchronised; None: unknown."""
        return kernel_clock().synchronised
