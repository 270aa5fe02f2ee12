"""Publishes a node's health on `/diagnostics` once a second."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ltm_ros.runtime.health import Health


class DiagnosticsPublisher:
    """Publishes on a steady clock: a replay that has ended stops ROS time, and diagnostics must go on."""

    def __init__(self, node: Node, health: Health, hardware_id: str = "") -> None:
        self._node, self._health, self._hardware_id = node, health, hardware_id
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        node.create_timer(1.0, self.publish, clock=self.steady_clock())

    @staticmethod
    def steady_clock() -> Clock:
        return Clock(clock_type=ClockType.STEADY_TIME)

    def publish(self) -> None:
        summary, troubled = self._health.summary(), self._health.troubled
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if troubled else DiagnosticStatus.OK,
            name=self._node.get_fully_qualified_name(),
            hardware_id=self._hardware_id,
            message=summary["last_error"] if troubled else "ok",
            values=[KeyValue(key=key, value=value) for key, value in summary.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
