"""Run a node's process: start, spin until stopped, finish its work, shut down."""

import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from ltm_core.base.errors import LtmError
from ltm_ros.runtime.handler import EX_CONFIG
from ltm_ros.runtime.heartbeat import HEARTBEAT, STARTING
from ltm_ros.runtime.process_memory import Trimming, settle, steady_allocation
from ltm_ros.runtime.ros_environment import limit_shutdown

EX_IOERR = 74
"""Exit status of a stopped node that could not write its remaining data (sysexits.h)."""


class Closable(Protocol):
    """A node, or several as `members`, to which more may be added at the end, with work to finish before they end."""

    def close(self) -> int:
        """Finish, and return the exit status of the process."""


class _StoppedEarly(BaseException):
    """A stop was requested while the node was being created."""


_AGAIN_S = 0.5


def _unless_stopped_early(lost: "sys.UnraisableHookArgs") -> None:
    if lost.exc_type is not _StoppedEarly:
        sys.__unraisablehook__(lost)


def run_until_stopped(name: str, make: Callable[[], Closable]) -> None:
    """Spin what `make` creates until SIGINT or SIGTERM, then `close` it while it can still publish.

    This is the last action of a process: after it returns, only moments are left to exit (`limit_shutdown`). Exits with
    EX_CONFIG if the configuration is invalid (LtmError), so that the graph does not restart it endlessly, and with the
    result of `close` if that is not 0."""
    sys.unraisablehook = _unless_stopped_early
    steady_allocation()  # if not set before: under `ros2 launch`
    stopping = threading.Event()
    making = True

    def stop(*_: object) -> None:
        stopping.set()
        # A node may load and compile for long, and has nothing to finish yet.
        if making:
            raise _StoppedEarly

    def insist() -> None:
        """Stop again: an exception that `stop` raised in a finalizer or weakref callback is lost."""
        while making:
            told = stopping.is_set()
            time.sleep(_AGAIN_S)
            if told and making:
                signal.pthread_kill(main, signal.SIGTERM)

    main = threading.get_ident()
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, stop)
        threading.Thread(target=insist, name="insist", daemon=True).start()
        # rclpy's own handlers would shut the context down before the node has finished and published.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = make()
        making = False
    except (LtmError, _StoppedEarly) as error:
        making = False
        limit_shutdown()
        if isinstance(error, LtmError):
            print(f"{name}: cannot start: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        if isinstance(error, LtmError):
            sys.exit(EX_CONFIG)
        return
    nodes: Sequence[Any] = getattr(node, "members", [node])
    # It waits for events; other executors rebuild a list of everything for each event.
    executor = EventsExecutor()
    added = 0
    settle()
    activity = HEARTBEAT.activity(name)
    STARTING.end()
    trimming = Trimming(time.monotonic())
    while rclpy.ok() and not stopping.is_set():
        for member in nodes[added:]:
            executor.add_node(member)
            added += 1
        with activity.turn("callback"):
            executor.spin_once(timeout_sec=0.1)
            trimming.look(time.monotonic())
    activity.begin("end", slow=True)
    status = node.close()
    limit_shutdown()
    executor.shutdown()
    for member in nodes:
        member.destroy_node()
    rclpy.try_shutdown()
    if status:
        sys.exit(status)
