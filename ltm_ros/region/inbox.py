"""Hold messages of towers until they are counted, and define their formats."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from typing import Final

from ltm_core.base.errors import MessageError
from ltm_core.uplink.config import AGGREGATOR, UplinkConfig
from ltm_core.uplink.envelope import VERSION, AckHeader, Outcome, VotesGrid, VotesHeader, header_of, outcomes_of
from ltm_core.uplink.outbox_io import OutboxFrame
from ltm_ros.region.identity import Identity
from ltm_ros.runtime.health import Health


def sealed_votes(identity: Identity, config: UplinkConfig, grid: VotesGrid, frame: OutboxFrame) -> bytes:
    """Return a frame's envelope. Raises MessageError if it would be too large, ValidationError for invalid names."""
    header = VotesHeader(
        region=config.name,
        tower=config.tower,
        camera=frame.camera,
        stamp_ns=frame.stamp_ns,
        model=frame.model,
        grid=grid,
    )
    return identity.sealed(header.model_dump_json().encode(), frame.message)


def outcomes_heard(identity: Identity, config: UplinkConfig, content: bytes) -> list[Outcome]:
    """Parse an acknowledgement. Raises MessageError if it is not from the aggregator, for this tower."""
    envelope = identity.opened(content, AGGREGATOR)
    header = header_of(AckHeader, envelope)
    if (header.region, header.tower, header.version) != (config.name, config.tower, VERSION):
        raise MessageError(
            f"an acknowledgement has version {header.version} for {header.tower} in {header.region}; this is "
            f"{config.tower} in {config.name}, version {VERSION}"
        )
    return outcomes_of(envelope)


def tell_what_waits(health: Health, frames: int, size: int, oldest_ns: int | None, now_ns: int, link_up: bool) -> None:
    """Set the gauges of a tower's queue for monitoring; `size`: bytes, `oldest_ns`: a stamp."""
    age_s = 0.0 if oldest_ns is None else max(0.0, (now_ns - oldest_ns) / 1e9)
    health.gauge("outbox_frames", frames)
    health.gauge("outbox_bytes", size)
    health.gauge("outbox_age_s", f"{age_s:.1f}")
    health.gauge("link_up", int(link_up))


WAITING_BYTES: Final = 64 << 20
"""Maximum bytes of all queued messages; above it, the newest message of the tower with most data is dropped, and sent
again by it."""
KEPT_BYTES: Final = 1000
"""Overhead in bytes of a queued message, so that empty messages cannot fill the memory."""
LONGEST_NAME: Final = 100
"""Characters kept of an unknown tower's name, which a broker may make 65,000 long."""


class Inbox:
    """`put` is called from the connection's thread, `get` from the counting one.

    Towers take turns, and if the queue is full, the tower with most data loses a message, so that none can delay
    others. `towers`: each has a turn; all other names share one. `most`: maximum bytes in the queue.
    """

    def __init__(self, towers: Sequence[str], health: Health, most: int = WAITING_BYTES) -> None:
        self._health, self._most = health, most
        self._lanes: dict[str, deque[tuple[str, bytes]]] = {name: deque() for name in [*towers, ""]}
        self._bytes = dict.fromkeys(self._lanes, 0)
        self._turns: deque[str] = deque()
        """Queues with messages, the next one first."""
        self._came = threading.Condition()
        self.bytes = 0
        """Bytes in the queues."""

    def put(self, tower: str, content: bytes) -> None:
        """Queue a message, unless the queue is full and its own tower has most of the data."""
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
                dropped.append(gone if most else "unknown towers")
            self._came.notify()
        for gone in dropped:
            self._health.drop(
                "overload",
                f"{self._most >> 20} MB are queued, most of them from {gone}, which sends the last ones again",
            )

    def get(self, timeout: float) -> tuple[str, bytes] | None:
        """Return tower and content of the next message; None: nothing came in `timeout` seconds."""
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
