"""Wait until nodes of a graph are ready: `python -m ltm_ros.launching.readiness --timeout 30 /ridge/fuel_map ...`.

A node is ready when it has sent a diagnostic, which it does after loading, or with `--discovered` when DDS has
discovered it. This is a separate process, so that the runner needs no DDS participant. Prints each node that becomes
ready; exits with 1 if some are not ready in time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from ltm_ros.runtime.ros_environment import limit_shutdown

NOT_READY = 1


class ReadinessWatch:
    """A node with its own context that records which nodes are ready."""

    def __init__(self, nodes: Iterable[str], discovered_suffices: bool = False) -> None:
        self.missing = dict.fromkeys(nodes)
        self._discovered_suffices = discovered_suffices
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("ltm_readiness", context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def wait(self, timeout_s: float) -> bool:
        """Return whether every node became ready within `timeout_s`; `missing` holds those that did not."""
        deadline = time.monotonic() + timeout_s
        while self.missing and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.1)
            if self._discovered_suffices:
                for name, namespace in self._node.get_node_names_and_namespaces():
                    self._tick_off(f"{namespace.rstrip('/')}/{name}")
        return not self.missing

    def close(self) -> None:
        limit_shutdown()
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._tick_off(status.name)

    def _tick_off(self, name: str) -> None:
        if name in self.missing:
            del self.missing[name]
            print(name, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("nodes", nargs="+")
    parser.add_argument("--timeout", type=float, required=True)
    parser.add_argument("--discovered", action="store_true")
    options = parser.parse_args()
    watch = ReadinessWatch(options.nodes, options.discovered)
    try:
        ready = watch.wait(options.timeout)
    finally:
        watch.close()
    sys.exit(0 if ready else NOT_READY)


if __name__ == "__main__":
    main()
