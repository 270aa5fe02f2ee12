"""Compute the pauses between failing attempts."""

import random

FIRST_RETRY_S = 2.0
"""Default pause after the first failure."""
LONGEST_RETRY_S = 15.0
"""Default upper limit of the pause."""
LAST_TRIES_S = 3.0
"""Time for which a node that is stopping tries to write its data; it is killed after ten seconds."""
LAST_PAUSE_S = 0.25
"""Pause between these last attempts."""


class Backoff:
    """Double the pause with each failure in a row, from `first_s` up to `longest_s`. Sleep for what `failed` returns;
    or, without a clock, count time with `passed` and try again once it is `due`.

    Args: jitter: shortens each pause by up to half, not below `first_s`, so that clients do not retry together."""

    def __init__(
        self, first_s: float = FIRST_RETRY_S, longest_s: float = LONGEST_RETRY_S, jitter: random.Random | None = None
    ) -> None:
        self._first_s, self._longest_s, self._jitter = first_s, longest_s, jitter
        self.pause_s = first_s
        """Pause after the next failure, before jitter, seconds."""
        self._left_s = 0.0

    @property
    def due(self) -> bool:
        """Return whether the next attempt may be made."""
        return self._left_s <= 0.0

    def passed(self, seconds: float) -> None:
        self._left_s -= seconds

    def failed(self) -> float:
        """Return the pause before the next attempt, seconds."""
        pause_s = self.pause_s
        if self._jitter is not None:
            pause_s = max(self._first_s, pause_s * self._jitter.uniform(0.5, 1.0))
        self.pause_s = min(2 * self.pause_s, self._longest_s)
        self._left_s = pause_s
        return pause_s

    def succeeded(self) -> None:
        self._left_s, self.pause_s = 0.0, self._first_s
