"""A real rclpy node whose parameter `behaviour` says how it lives and dies: `python -m nodes_for_tests`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import ExternalShutdownException

EX_CONFIG = 78


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("unnamed", automatically_declare_parameters_from_overrides=True)
    behaviour = node.get_parameter("behaviour").value
    print(f"hello from {node.get_fully_qualified_name()} pid {os.getpid()}", flush=True)
    if behaviour == "config_error":
        print("the DEM moon.tif does not exist", file=sys.stderr)
        sys.exit(EX_CONFIG)
    if behaviour == "stubborn":
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if behaviour == "with_child":
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        print(f"child {child.pid}", flush=True)
    publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    status = DiagnosticStatus(name=node.get_fully_qualified_name())

    def diagnose() -> None:
        if behaviour != "silent":
            publisher.publish(DiagnosticArray(status=[status]))

    node.create_timer(0.2, diagnose)
    try:
        while behaviour == "stubborn":
            diagnose()
            time.sleep(0.2)
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        print("goodbye", flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
