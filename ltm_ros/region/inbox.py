"""What came for a region's map and waits to be counted: bounded, and shared fairly by the towers."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from typing import Final

from ltm_ros.runtime.health import Health

WAITING_BYTES: Final = 64 << 20
"""Of all that waits; above it, what came last of the tower of which most waits is dropped, and sent again by it."""
KEPT_BYTES: Final = 1000
"""What a message takes that waits, beside its payload: any number of empty ones shall not fill the memory."""
LONGEST_NAME: Final = 100
"""Characters that are kept of a name that is no tower's: a broker may make it 65,000 long."""


class Inbox:
    """`put` from the connection's thread, `get` from the one that counts.

    Towers take turns, and where there is no room the one with the most in here loses it: a tower that sends without
    end, with a good certificate, delays nobody else's frames and costs them no place.

    Args:
        towers: who has a turn; all other names together have one more.
        most: bytes that may wait.
    """

    def __init__(self, towers: Sequence[str], health: Health, most: int = WAITING_BYTES) -> None:
        self._health, self._most = health, most
        self._lanes: dict[str, deque[tuple[str, bytes]]] = {name: deque() for name in [*towers, ""]}
        self._bytes = dict.fromkeys(self._lanes, 0)
        self._turns: deque[str] = deque()
        """Lanes in which something waits, the next one first."""
        self._came = threading.Condition()
        self.bytes = 0
        """That wait."""

    def put(self, tower: str, content: bytes) -> None:
        """Keep a message, unless no room is left and most of what waits is its own tower's."""
        name, tower = (tower, tower) if tower in self._lanes else ("", tower[:LONGEST_NAME])
        with self._came:
            if not self._lanes[name]:
                self._turns.append(name)
            self._lanes[name].append((tower, content))
            self._account(name, KEPT_BYTES + len(content))
            dropped = []
            while self.bytes > self._most:
                most = max(self._bytes, key=self._bytes.__getitem__)
                gone, content = self._lanes[most].pop()
                self._account(most, -KEPT_BYTES - len(content))
                if not self._lanes[most]:
                    self._turns.remove(most)
                dropped.append(gone if most else "names that are no towers")
            self._came.notify()
        for gone in dropped:
            self._health.drop(
                "overload",
                f"{self._most >> 20} MB wait to be counted, most of them of {gone}, which sends the last ones again",
            )

    def get(self, timeout: float) -> tuple[str, bytes] | None:
        """Tower and content of the next message; None: nothing came in `timeout` seconds."""
        with self._came:
            if not self._turns and not self._came.wait_for(lambda: bool(self._turns), timeout):
                return None
            name = self._turns.popleft()
            tower, content = self._lanes[name].popleft()
            self._account(name, -KEPT_BYTES - len(content))
            if self._lanes[name]:
                self._turns.append(name)
            return tower, content

    def _account(self, lane: str, by: int) -> None:
        self._bytes[lane] += by
        self.bytes += by
