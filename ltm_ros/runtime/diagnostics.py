"""Publish the health of nodes on `/diagnostics`, and summarise it at the end of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ltm_ros.runtime.delivery_checks import TRAFFIC
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.process_memory import memory_in_use


class DiagnosticsPublisher:
    """Publishes on a steady clock, because diagnostics must continue when a replay's ROS time stops.

    `healths`: by full name, of the nodes that `node` reports for, in one message; the first includes the process's
    memory (`heap_bytes`, `python_blocks`).
    """

    def __init__(self, node: Node, healths: Mapping[str, Health], hardware_id: str = "") -> None:
        self._node, self._healths, self._hardware_id = node, healths, hardware_id
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
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
        self._said.messages += 1

    def _status(self, name: str, health: Health) -> DiagnosticStatus:
        summary, troubled = health.summary(), health.troubled
        return DiagnosticStatus(
            level=DiagnosticStatus.WARN if troubled else DiagnosticStatus.OK,
            name=name,
            hardware_id=self._hardware_id,
            message=summary["last_error"] if troubled else "ok",
            values=[KeyValue(key=key, value=value) for key, value in summary.items()],
        )


@dataclass(frozen=True)
class NodeRow:
    """Final report of a node; latencies since capture, NaN without any."""

    node: str
    received: int
    published: int
    dropped: int
    latency_p50_ms: float = math.nan
    latency_p95_ms: float = math.nan
    work_p50_ms: float = math.nan
    causes: str = ""
    """Causes of drops: `overload 2, pose 1`."""
    reasons: tuple[str, ...] = ()
    """Reason of the first drop of each cause, after its name."""

    @classmethod
    def of(cls, node: str, summary: dict[str, str]) -> NodeRow:
        """Parse the key -> value texts of a node's `/diagnostics` status."""
        causes = {key.removeprefix("dropped."): value for key, value in summary.items() if key.startswith("dropped.")}
        return cls(
            node,
            int(summary.get("frames_in", 0)),
            int(summary.get("frames_out", 0)),
            int(summary.get("dropped", 0)),
            float(summary.get("latency_p50_ms", math.nan)),
            float(summary.get("latency_p95_ms", math.nan)),
            float(summary.get("work_p50_ms", math.nan)),
            ", ".join(f"{cause} {count}" for cause, count in causes.items()),
            tuple(f"{key.removeprefix('reason.')}: {why}" for key, why in summary.items() if key.startswith("reason.")),
        )


def node_rows(summaries: Mapping[str, Mapping[str, str]]) -> list[NodeRow]:
    """Return one row per node, by name, from the key -> value texts of their diagnostics."""
    return [NodeRow.of(name, dict(summary)) for name, summary in sorted(summaries.items())]
