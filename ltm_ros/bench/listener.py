"""What a benchmark hears of a graph: updates of the fuel map with their time of arrival, and diagnostics."""

from __future__ import annotations

import struct
import threading
import time
from types import TracebackType
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from ltm_ros.launching.dds_shutdown import wait_for_quiet
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, site_topic


class Listener:
    """`arrived`: when the map first told of each stamp, by the clock of this machine; `summaries`: every node's last
    diagnostics, by its full name. Used as a context manager.
    """

    def __init__(self, site: str) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("bench", context=self._context, enable_rosout=False)
        self.arrived: dict[int, float] = {}
        self.summaries: dict[str, dict[str, str]] = {}
        qos = stream_qos(depth=FUEL_MAP_UPDATE.depth)
        self._node.create_subscription(OccupancyGrid, site_topic(site, FUEL_MAP_UPDATE), self._updated, qos, raw=True)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, 200)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._thread.join()
        self._executor.shutdown()
        wait_for_quiet(self._node)
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _updated(self, cdr: bytes) -> None:
        sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
        self.arrived.setdefault(sec * 10**9 + nanosec, time.time())

    def _diagnosed(self, message: Any) -> None:
        for status in message.status:
            self.summaries[status.name] = {item.key: item.value for item in status.values}

    def _spin(self) -> None:
        while not self._stopping.is_set():
            self._executor.spin_once(timeout_sec=0.1)
