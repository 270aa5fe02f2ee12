"""Publish the health of nodes on `/diagnostics`, and summarise it at the end of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ltm_msgs_py.status import status_message
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.heartbeat import HEARTBEAT, TRAFFIC
from ltm_ros.runtime.process_memory import memory_in_use


class DiagnosticsPublisher:
    """Publishes on a steady clock, because diagnostics must continue when a replay's ROS time stops.

    `healths`: by full name, of the nodes that `node` reports for, in one message; the first includes the process's
    memory (`heap_bytes`, `python_blocks`). `others`: returns further statuses.
    """

    def __init__(
        self,
        node: Node,
        healths: Mapping[str, Health],
        hardware_id: str = "",
        others: Callable[[], list[DiagnosticStatus]] = list,
    ) -> None:
        self._node, self._healths, self._hardware_id, self._others = node, healths, hardware_id, others
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._said = TRAFFIC.speaker("/diagnostics")
        node.create_timer(1.0, self.publish, clock=self.steady_clock())

    @staticmethod
    def steady_clock() -> Clock:
        return Clock(clock_type=ClockType.STEADY_TIME)

    def publish(self) -> None:
        first, in_use = next(iter(self._healths.values())), memory_in_use()
        first.gauge("python_blocks", in_use.python_blocks)
        if in_use.heap_bytes is not None:
            first.gauge("heap_bytes", in_use.heap_bytes)
        array = DiagnosticArray(status=[self._status(name, health) for name, health in self._healths.items()])
        array.status.extend(self._others())
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
        self._said.messages += 1
        HEARTBEAT.ready(self._healths)

    def _status(self, name: str, health: Health) -> DiagnosticStatus:
        level = DiagnosticStatus.WARN if health.troubled else DiagnosticStatus.OK
        return status_message(name, level, health.message, health.summary(), self._hardware_id)
