"""Check stamps against the time of the graph."""

import math
from collections.abc import Callable

from pydantic import Field

from ltm_ros.runtime.handler import NodeConfig
from ltm_ros.runtime.health import Health

CLOCKS_SET_NS = 946_684_800_000_000_000
"""The year 2000: an earlier stamp is from a clock that was never set, and would count as a view decades apart."""


class StampLimits(NodeConfig):
    """Parameters of a node that stores what it receives."""

    # Synchronised clocks agree within a second; a radio link may fail for days and deliver then.
    max_ahead: float = Field(10.0, gt=0)
    """Maximum seconds by which a sender's clock may be ahead; messages from the future would make all others old."""
    max_behind: float = Field(7 * 86400.0, gt=0)
    """Maximum seconds by which a message may be late; use a replay for older ones."""


class StampCheck:
    """Rejects stamps that contradict the graph's time, which in a replay is the recording's: a future stamp would make
    all others old, and a past one could count as a second view after a long time.

    Args: now_ns: the graph's time; 0 before it begins, when no stamp is ahead or behind. health: counts rejected
    messages as `future`, `past` or `unset_clock`. max_ahead: seconds by which a source's clock may be ahead.
    max_behind: seconds by which a message may be late."""

    def __init__(
        self, now_ns: Callable[[], int], health: Health, max_ahead: float = math.inf, max_behind: float = math.inf
    ) -> None:
        self._now_ns, self._health = now_ns, health
        self._max_ahead, self._max_behind = max_ahead, max_behind

    def refuses(self, what: str, stamp_ns: int) -> bool:
        """Return whether the message, `what` in words, must be rejected; then it is counted as dropped."""
        now = self._now_ns()
        # A graph whose own time is that early follows a simulation's clock, which begins at zero.
        if stamp_ns < CLOCKS_SET_NS and not 0 < now < CLOCKS_SET_NS:
            self._health.drop("unset_clock", f"{what} has the stamp {stamp_ns} ns; set the camera's clock")
            return True
        if self.ahead(what, stamp_ns):
            return True
        behind = (now - stamp_ns) / 1e9
        if now and behind > self._max_behind:
            remedy = "synchronise the clocks, or replay messages of this age"
            self._health.drop("past", f"{what}: {behind:.0f} s behind this node's clock; {remedy}")
            return True
        return False

    def ahead(self, what: str, stamp_ns: int) -> bool:
        """Return whether the stamp is in the future; the only check for messages that may be old."""
        now = self._now_ns()
        if now and stamp_ns > now + self._max_ahead * 1e9:
            ahead = (stamp_ns - now) / 1e9
            self._health.drop("future", f"{what}: {ahead:.0f} s ahead of this node's clock; synchronise the clocks")
            return True
        return False
