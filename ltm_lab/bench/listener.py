"""What a benchmark hears of a graph: updates of the fuel map with their time of arrival, and diagnostics."""

from __future__ import annotations

import struct
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid

from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.spinning_node import SpinningNode
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, site_topic


class Listener(SpinningNode):
    """`arrived`: when the map first told of each stamp, by the clock of this machine; `summaries`: every node's last
    diagnostics, by its full name. Used as a context manager.
    """

    def __init__(self, site: str) -> None:
        super().__init__("bench")
        self.arrived: dict[int, float] = {}
        self.summaries: dict[str, dict[str, str]] = {}
        qos = stream_qos(depth=FUEL_MAP_UPDATE.depth)
        self.node.create_subscription(OccupancyGrid, site_topic(site, FUEL_MAP_UPDATE), self._updated, qos, raw=True)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, 200)

    def _updated(self, cdr: bytes) -> None:
        sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
        self.arrived.setdefault(sec * 10**9 + nanosec, time.time())

    def _diagnosed(self, message: Any) -> None:
        for status in message.status:
            self.summaries[status.name] = {item.key: item.value for item in status.values}
