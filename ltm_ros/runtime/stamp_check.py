"""Check stamps of messages against the time of the graph, and detect repeated photos."""

from __future__ import annotations

import math
from collections.abc import Callable

from ltm_ros.runtime.health import Health

CLOCKS_SET_NS = 946_684_800_000_000_000
"""The year 2000: a stamp before it is of a clock that was never set, and would look like a view decades apart."""
MAX_AHEAD_S = 10.0
"""Default of nodes: clocks that are set at all agree within a second. Whoever stamps ahead pushes out what is late: the
longer ahead, the longer."""
MAX_BEHIND_S = 7 * 86400.0
"""Default of nodes: a radio link may be away for days and deliver then; older frames belong into a replay."""
JUMP_S = 60.0
"""By which a source's lateness changes from one frame to the next where its clock, or this one, was set."""


class StampCheck:
    """Refuses stamps that the graph's time contradicts.

    What is counted from the future makes all else old, and what is counted from the past may pass for a second look
    after a long time. In a replay the graph's time is the recording's.

    Args:
        now_ns: the graph's time; 0 while it has not begun, when nothing is ahead and nothing behind.
        health: counts what is refused, as `future`, `past` or `unset_clock`, and notes `stamp_jump`.
        max_ahead: seconds by which a source's clock may be ahead.
        max_behind: seconds by which a message may be late.
    """

    def __init__(
        self,
        now_ns: Callable[[], int],
        health: Health,
        max_ahead: float = math.inf,
        max_behind: float = math.inf,
    ) -> None:
        self._now_ns, self._health = now_ns, health
        self._max_ahead, self._max_behind = max_ahead, max_behind
        self._lateness: dict[str, float] = {}

    def refuses(self, what: str, stamp_ns: int) -> bool:
        """Whether the message, `what` in words, must not be taken; it is counted as dropped then."""
        now = self._now_ns()
        # A graph whose own time is that early follows a simulation's clock, which begins at zero.
        if stamp_ns < CLOCKS_SET_NS and not 0 < now < CLOCKS_SET_NS:
            self._health.drop("unset_clock", f"{what} has the stamp {stamp_ns} ns; set the camera's clock")
            return True
        if self.ahead(what, stamp_ns):
            return True
        behind = (now - stamp_ns) / 1e9
        if now and behind > self._max_behind:
            self._health.drop(
                "past", f"{what}: {behind:.0f} s behind this node's clock; set the clocks, or replay what is that old"
            )
            return True
        if now:
            if abs(behind - self._lateness.get(what, behind)) > JUMP_S:
                self._health.note("stamp_jump")
            self._lateness[what] = behind
        return False

    def ahead(self, what: str, stamp_ns: int) -> bool:
        """Whether it has not come yet: all that is asked of what may well be old, as a map that is sent once more."""
        now = self._now_ns()
        if now and stamp_ns > now + self._max_ahead * 1e9:
            ahead = (stamp_ns - now) / 1e9
            self._health.drop("future", f"{what}: {ahead:.0f} s ahead of this node's clock; set the clocks")
            return True
        return False


class RepeatCheck:
    """Of one camera's pictures, in the order in which they come."""

    def __init__(self) -> None:
        self._last = ""

    def repeats(self, content: str) -> bool:
        """Whether a picture is the one before, byte for byte; `content`: its digest. From here on it is the one before.

        Two pictures of a living camera never are: its sensor's noise differs.
        """
        same, self._last = content == self._last, content
        return same
