"""Listen to the graph: which frames the fuel map has announced as stored, and when each node last reported."""

import threading
import time
from collections import defaultdict
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from scenes.small_site import NAME

from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import CAMERAS_PROCESS
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, site_topic

DEPTH = 5000
"""Maximum number of waiting updates: after an hour of a full disk, all frames are announced at once."""


class Listener:
    """Monotonic times in seconds at which each frame was announced, by stamp, and at which each node last reported."""

    def __init__(self, node: Node) -> None:
        self.strangers: set[str] = set()
        """Nodes of another graph in the same domain."""
        self.latest: dict[str, dict[str, str]] = {}
        """The last report of each node, by label."""
        self._announced: dict[int, list[float]] = defaultdict(list)
        self._reported: dict[str, float] = {}
        self._lock = threading.Lock()
        update = site_topic(NAME, FUEL_MAP_UPDATE)
        node.create_subscription(FUEL_MAP_UPDATE.type, update, self._take_update, stream_qos(depth=DEPTH))
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take_reports, 200)

    def announced(self) -> dict[int, list[float]]:
        """Return the times at which each stamp has been announced; several if it was announced several times."""
        with self._lock:
            return {stamp: list(times) for stamp, times in self._announced.items()}

    def reported_since(self, label: str, at: float) -> bool:
        """Whether a process has reported after that moment: all nodes, of the process that those of cameras share."""
        with self._lock:
            if label == CAMERAS_PROCESS:
                times = [then for name, then in self._reported.items() if "/" in name]
                return bool(times) and min(times) > at
            return self._reported.get(label, 0.0) > at

    def _take_update(self, message: Any) -> None:
        with self._lock:
            self._announced[stamp_of(message)].append(time.monotonic())

    def _take_reports(self, message: Any) -> None:
        with self._lock:
            for status in message.status:
                site, _, label = status.name.removeprefix("/").partition("/")
                if site != NAME:
                    self.strangers.add(status.name)
                    continue
                self._reported[label] = time.monotonic()
                self.latest[label] = {item.key: item.value for item in status.values}
