"""One launch of a parallel kernel at a time: numba's fallback threading layer dies when two threads launch at once."""

from __future__ import annotations

import threading

ONE_LAUNCH = threading.Lock()
"""Held around every call of a kernel that was compiled with `parallel=True`."""
