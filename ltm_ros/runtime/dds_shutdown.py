"""Ends a process's DDS participant without the risk of hanging.

The end of a Fast DDS participant waits for a discovery callback that is just running. In the ROS wheels (2.14.5, built
with GCC's libstdc++ 9 or older) that wait spins while holding the very lock that the callback needs: for ever, and
holding Python's interpreter lock too, so that no Python signal handler runs (Fast-DDS, issue 6513). Callbacks run when
other participants come or go, so it happens when a graph stops.
"""

from __future__ import annotations

import signal
import time

from rclpy.node import Node

SHUTDOWN_CPU_S = 3.0
"""Processor time that leaving the middleware and the interpreter may take; a node of ours needs 0.5 to 0.9 s."""
PATIENCE_S = 3.0
QUIET_S = 0.3
POLL_S = 0.02


def limit_shutdown(cpu_s: float = SHUTDOWN_CPU_S) -> None:
    """From here on this process ends by SIGPROF when it has used `cpu_s` of processor time and is still there.

    For the last act of a process that has finished its work and sent what it had to send. Processor time, because a
    stuck participant spins, and a healthy one on a busy machine waits.
    """
    # The signal's default action needs no lock of the interpreter, which a stuck participant would not give.
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, cpu_s)


def wait_for_quiet(node: Node, patience_s: float = PATIENCE_S) -> bool:
    """Wait until no endpoint has come or gone for a moment: no discovery callback runs then.

    For a process that goes on after its participant. False when others still came and went after `patience_s`.
    """
    deadline = time.monotonic() + patience_s
    last, since = _endpoints(node), time.monotonic()
    while (now := time.monotonic()) < deadline:
        if now - since > QUIET_S:
            return True
        time.sleep(POLL_S)
        if (endpoints := _endpoints(node)) != last:
            last, since = endpoints, time.monotonic()
    return False


def _endpoints(node: Node) -> dict[str, tuple[int, int]]:
    """How many publish and how many listen, by topic."""
    topics = (name for name, _ in node.get_topic_names_and_types())
    return {topic: (node.count_publishers(topic), node.count_subscribers(topic)) for topic in topics}
