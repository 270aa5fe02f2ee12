"""What the fuel map has told of: an update says that the frame of its stamp is on the disk."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from typing import Any

from rclpy.node import Node
from scenes.small_site import NAME

from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, site_topic

DEPTH = 5000
"""After an hour of a full disk all is told of at once."""


class Acknowledgements:
    """Monotonic seconds at which each stamp was told of; more than one where it was told of twice."""

    def __init__(self, node: Node) -> None:
        self._at: dict[int, list[float]] = defaultdict(list)
        self._lock = threading.Lock()
        node.create_subscription(
            FUEL_MAP_UPDATE.type, site_topic(NAME, FUEL_MAP_UPDATE), self._take, stream_qos(depth=DEPTH)
        )

    def snapshot(self) -> dict[int, list[float]]:
        """As of now."""
        with self._lock:
            return {stamp: list(times) for stamp, times in self._at.items()}

    def when(self, stamp_ns: int) -> float | None:
        """When a frame was told of first; None: not yet."""
        with self._lock:
            times = self._at.get(stamp_ns)
            return times[0] if times else None

    def _take(self, message: Any) -> None:
        with self._lock:
            self._at[stamp_of(message)].append(time.monotonic())
