"""Whether a message's stamp can be believed: one check for all nodes that count by stamps."""

from __future__ import annotations

from collections.abc import Callable

from ltm_ros.runtime.health import Health

CLOCKS_SET_NS = 946_684_800_000_000_000
"""The year 2000: a stamp before it is of a clock that was never set, and would look like a view decades apart."""


class StampCheck:
    """Refuses stamps that are ahead of the graph's time: what is counted from the future makes all else old.

    Args:
        now_ns: the graph's time; 0 while it has not begun, when nothing is ahead.
        health: counts what is refused, as `future` or `unset_clock`.
        max_ahead: seconds by which a camera's clock may be ahead.
        refuse_unset: also refuse stamps of clocks that were never set.
    """

    def __init__(self, now_ns: Callable[[], int], health: Health, max_ahead: float, refuse_unset: bool = False) -> None:
        self._now_ns, self._health, self._max_ahead, self._refuse_unset = now_ns, health, max_ahead, refuse_unset

    def refuses(self, what: str, stamp_ns: int) -> bool:
        """Whether the message, `what` in words, must not be taken; it is counted as dropped then."""
        if self._refuse_unset and stamp_ns < CLOCKS_SET_NS:
            self._health.drop("unset_clock", f"{what} has the stamp {stamp_ns} ns; set the camera's clock")
            return True
        now = self._now_ns()
        if now and stamp_ns > now + self._max_ahead * 1e9:
            ahead = (stamp_ns - now) / 1e9
            self._health.drop("future", f"{what}: {ahead:.0f} s ahead of this node's clock; set the clocks")
            return True
        return False
