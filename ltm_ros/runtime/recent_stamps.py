"""The stamps of a camera's last frames, by which a second message of one is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_NONE = np.iinfo(np.int64).min


class RecentStamps:
    """The last `count` stamps, nanoseconds, in one block of memory.

    Not a set or a dictionary: for each frame that came and went they would put small things among all others, to be
    freed a thousand frames later, and the holes keep pages. To look through a thousand takes microseconds.
    """

    def __init__(self, count: int) -> None:
        self._stamps: NDArray[np.int64] = np.full(count, _NONE)
        self._next = 0

    def __contains__(self, stamp_ns: int) -> bool:
        return bool((self._stamps == stamp_ns).any())

    def add(self, stamp_ns: int) -> None:
        """In the place of the one that was added `count` stamps ago."""
        self._stamps[self._next] = stamp_ns
        self._next = (self._next + 1) % len(self._stamps)
