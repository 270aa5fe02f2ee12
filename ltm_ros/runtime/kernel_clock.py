"""What the kernel says of this machine's clock: adjtimex(2), asked without rights and without a change."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

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
