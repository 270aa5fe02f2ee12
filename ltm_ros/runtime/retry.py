"""Paces attempts at something that is away: each failure doubles the pause, up to a limit."""

from __future__ import annotations

RETRY_S = 2.0
"""The first pause."""
LONGEST_RETRY_S = 15.0
LAST_TRIES_S = 3.0
"""For which a node that is told to stop tries to write what it has: it is killed after ten seconds."""
LAST_PAUSE_S = 0.25
"""Between these."""


class RetryPace:
    """Counts time that it is told of, as handlers do not look at clocks. `longest`: pause, seconds."""

    def __init__(self, longest: float = LONGEST_RETRY_S) -> None:
        self._longest = longest
        self._pause = RETRY_S
        self._left = 0.0

    @property
    def due(self) -> bool:
        """Whether the next attempt may be made."""
        return self._left <= 0.0

    def passed(self, seconds: float) -> None:
        self._left -= seconds

    def failed(self) -> None:
        self._left = self._pause
        self._pause = min(2 * self._pause, self._longest)

    def succeeded(self) -> None:
        self._left, self._pause = 0.0, RETRY_S
