"""When a camera that failed is asked again."""

from __future__ import annotations

import random

FIRST_S, LONGEST_S = 1.0, 60.0
UNAUTHORISED_S = 600.0
"""After a refused password: cameras lock an account after a few of them in some minutes."""


class Backoff:
    """Twice as long after each failure in a row, with jitter: cameras that a switch took down come back one by one."""

    def __init__(self, random_source: random.Random | None = None) -> None:
        self._random = random_source or random.Random()  # nosec B311 # spreads load, guards nothing
        self._failures = 0

    def succeeded(self) -> None:
        self._failures = 0

    def failed(self) -> float:
        """Seconds to wait: between half of 1, 2, 4 ... 60 and all of it, never less than 1."""
        longest = min(LONGEST_S, FIRST_S * 2.0 ** min(self._failures, 10))
        self._failures += 1
        return max(FIRST_S, longest * self._random.uniform(0.5, 1.0))

    def unauthorised(self) -> float:
        """Seconds to wait: one try in ten minutes."""
        self._failures += 1
        return UNAUTHORISED_S * self._random.uniform(1.0, 1.05)
