"""A real node whose parameter `behaviour` says how it lives and dies: `python -m nodes_for_tests`."""

import os
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from ltm_core.base.errors import ConfigError
from ltm_ros.runtime.heartbeat import HEARTBEAT
from ltm_ros.runtime.node_process import run_until_stopped


class Slow:
    """Its end takes for ever, and what is raised there is lost."""

    def __del__(self) -> None:
        time.sleep(600)


class Actor(Node):
    """Says hello and goodbye, and sends a diagnostic now and then."""

    def __init__(self) -> None:
        super().__init__("unnamed", automatically_declare_parameters_from_overrides=True)
        behaviour = self.get_parameter("behaviour").value
        print(f"hello from {self.get_fully_qualified_name()} pid {os.getpid()}", flush=True)
        if behaviour == "config_error":
            raise ConfigError("the DEM moon.tif does not exist")
        if behaviour == "loses_the_stop":
            Slow()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        if behaviour == "stubborn":
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while behaviour in ("stubborn", "slow_to_start", "loses_the_stop"):
            if behaviour == "stubborn":
                self._diagnose()
            time.sleep(0.2)  # it does nothing else, for ever
        self.create_timer(0.2, self._diagnose)

    def close(self) -> None:
        print("goodbye", flush=True)

    def _diagnose(self) -> None:
        self._diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(name=self.get_fully_qualified_name())]))
        HEARTBEAT.ready([self.get_fully_qualified_name()])


if __name__ == "__main__":
    run_until_stopped("actor", Actor)
