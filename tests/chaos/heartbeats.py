"""When each node last reported on `/diagnostics`, and what it has counted."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Collection
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from ltm_ros.launching.graph import CAMERAS_PROCESS


class Heartbeats:
    """By label, as `tower/depth`. `site`: its name. `processes`: labels of those that are a node each, or the cameras'.

    Of another site's graph in the same domain only the names are kept, in `strangers`: whoever joins costs memory in
    every process.
    """

    def __init__(self, node: Node, site: str, processes: Collection[str]) -> None:
        self._site, self._processes = site, processes
        self.strangers: set[str] = set()
        self._at: dict[str, float] = {}
        self._latest: dict[str, dict[str, str]] = {}
        self._lock = threading.Lock()
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 200)

    def since(self, label: str, at: float) -> bool:
        """Whether it has reported after that moment: all nodes, of the process that those of cameras share."""
        with self._lock:
            if label == CAMERAS_PROCESS:
                times = [then for name, then in self._at.items() if "/" in name]
                return bool(times) and min(times) > at
            return self._at.get(label, 0.0) > at

    def counted(self) -> Counter[str]:
        """What living nodes have dropped and noted by now: a restarted node begins at zero."""
        with self._lock:
            return Counter(
                {
                    f"{label} {key}": int(value)
                    for label, summary in self._latest.items()
                    for key, value in summary.items()
                    if key.startswith(("dropped.", "noted."))
                }
            )

    def said(self) -> dict[str, dict[str, str]]:
        """The last report of each node, whole."""
        with self._lock:
            return {label: dict(summary) for label, summary in self._latest.items()}

    def _take(self, message: Any) -> None:
        with self._lock:
            for status in message.status:
                site, _, label = status.name.removeprefix("/").partition("/")
                if site != self._site:
                    self.strangers.add(status.name)
                    continue
                self._at[label] = time.monotonic()
                self._latest[label] = {item.key: item.value for item in status.values}
