import itertools
import signal
import subprocess
import sys
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="the ROS extra is not installed")

from ltm_ros.runtime import ros_environment as dds_shutdown

LEAVE = "import sys, time; from ltm_ros.runtime.ros_environment import limit_shutdown; limit_shutdown(0.2); "


def leave(last_act: str) -> int:
    """How a process ends that does this after its farewell has begun."""
    return subprocess.run([sys.executable, "-c", LEAVE + last_act], timeout=60).returncode


def test_a_process_that_spins_at_its_end_is_ended() -> None:
    # One call into C that keeps the interpreter's lock for days and looks at no signal, as a stuck participant does.
    assert leave("sum(range(10**15))") == -signal.SIGPROF


def test_a_process_that_waits_at_its_end_is_left_alone() -> None:
    assert leave("time.sleep(0.6)") == 0  # longer than its farewell may take: that nothing happens then is the point


class Graph:
    """As a node sees it: topics whose number of publishers and listeners follows a script, then stays."""

    def __init__(self, *publishers: int) -> None:
        self._publishers = itertools.chain(publishers, itertools.repeat(publishers[-1]))

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [("/diagnostics", ["diagnostic_msgs/msg/DiagnosticArray"])]

    def count_publishers(self, topic: str) -> int:
        return next(self._publishers)

    def count_subscribers(self, topic: str) -> int:
        return 1


def quiet(graph: Any, patience_s: float) -> bool:
    return dds_shutdown.wait_for_quiet(graph, patience_s)


def test_waits_until_nobody_comes_or_goes() -> None:
    graph = Graph(3, 4, 4, 5, 4, 2)
    assert quiet(graph, patience_s=30.0)
    assert graph.count_publishers("/diagnostics") == 2
