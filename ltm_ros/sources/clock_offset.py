"""By how much a camera's clock is off, from what it said and when that came. Epoch seconds of the camera's clock less
monotonic seconds of ours, so that a step of our own time of day changes nothing."""

from __future__ import annotations

from collections import deque

DRIFT = 1e-4
"""By which a clock's rate is off at most: crystals of cameras keep a tenth of that, in frost and sun too."""
KEPT = 64
"""Observations of which bounds are made."""
WINDOW_S = 60.0
"""In which the fastest picture of a stream counts,"""
LEAST = 20
"""and of slow streams so many at least."""
STEP_S = 0.5
"""By which all pictures of a stream come later than the fastest where its clock was set back,"""
STEP_AFTER = 10
"""so many in a row."""


class OffsetBounds:
    """An offset of which each observation says that it lies in an interval: all of them together make it narrow, for a
    clock of whole seconds is asked at all phases of its second."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float, float]] = deque(maxlen=KEPT)

    @property
    def known(self) -> bool:
        return bool(self._seen)

    def add(self, low: float, high: float, now: float) -> bool:
        """The offset was within [low, high] at `now`. True where that contradicts what was known: the clock was set,
        and all before is forgotten."""
        contradicts = False
        if self._seen:
            known_low, known_high = self.at(now)
            contradicts = low > known_high or high < known_low
        if contradicts:
            self._seen.clear()
        self._seen.append((low, high, now))
        return contradicts

    def at(self, now: float) -> tuple[float, float]:
        """The interval in which it lies now."""
        low = max(low - DRIFT * (now - then) for low, _, then in self._seen)
        high = min(high + DRIFT * (now - then) for _, high, then in self._seen)
        # Two clocks that drift apart more than they may leave nothing between them.
        return (low, high) if low <= high else ((low + high) / 2,) * 2

    def middle(self, now: float) -> float:
        low, high = self.at(now)
        return (low + high) / 2


class FastestArrival:
    """Of a stream with times to the millisecond: the running minimum of arrival less stated time. The fastest picture
    shows the offset, less what it took itself."""

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()
        self.count = 0

    def add(self, stated: float, arrived: float, *, begins: bool = False) -> bool:
        """True where what came lately is so late that the clock must have been set back: only that counts then.

        `begins`: whether it is the first picture of a connection, which alone shows that.
        """
        self.count += 1
        self._delays.append((arrived, arrived - stated))
        while len(self._delays) > LEAST and self._delays[0][0] < arrived - WINDOW_S:
            self._delays.popleft()
        latest = list(self._delays)[-1 if begins else -STEP_AFTER :]
        if len(self._delays) > len(latest) and min(d for _, d in latest) > self._fastest() + STEP_S:
            self._delays = deque(latest)
            self.count = len(latest)
            return True
        return False

    def offset(self) -> float:
        """Without what the fastest picture took."""
        return -self._fastest()

    def _fastest(self) -> float:
        return min(delay for _, delay in self._delays)
