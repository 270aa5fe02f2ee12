"""Run a handler live: an rclpy node that passes messages to it and publishes its results."""

import contextlib
import os
import queue
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from std_srvs.srv import Trigger

from ltm_core.base.errors import LtmError
from ltm_ros.runtime.delivery_checks import DiagnosticsPublisher
from ltm_ros.runtime.handler import ConfigT, NodeType
from ltm_ros.runtime.health import cause_of
from ltm_ros.runtime.heartbeat import HEARTBEAT
from ltm_ros.runtime.node_process import EX_IOERR, run_until_stopped
from ltm_ros.runtime.outlet_node import WIRING_S, OutletNode
from ltm_ros.runtime.stamp_join import data_bytes

QUEUE = 30
QUEUE_PER_TOPIC = 10
"""Maximum number of queued messages before the newest is dropped and counted; the larger of both limits applies,
because a frame has a message on each topic."""
QUEUE_BYTES = 512 << 20
"""Maximum bytes of queued image data, so that the viewer of twenty towers cannot fill the memory."""


class HandlerNode(OutletNode):
    """Runs one handler: messages are queued for a worker thread, so that the middleware is drained while it works."""

    def __init__(self, node_type: NodeType[ConfigT]) -> None:
        super().__init__(node_type)
        self._last_tick, self._tick_waits = time.monotonic(), False
        self.handler = node_type.handler(self.config, self, self.health)
        subscriptions = self.handler.subscriptions
        most = max(QUEUE, QUEUE_PER_TOPIC * len(subscriptions))
        self._inbox: queue.Queue[tuple[Callable[[Any], None], Any] | None] = queue.Queue(most)
        self._bytes_in = self._bytes_out = 0  # each is written by one thread only
        for topic in self.handler.publications:
            self.open(topic)
        self.handler.start()
        for topic, callback in subscriptions.items():
            self.listen(topic, partial(self._offer, callback))
        for service, action in self.handler.services.items():
            self.create_service(Trigger, service, self._serve(action))
        own, steady = {self.get_fully_qualified_name(): self.health}, DiagnosticsPublisher.steady_clock()
        self._diagnostics = DiagnosticsPublisher(self, own, self.config.camera)
        self.create_timer(0.5, self._tick, clock=steady)
        self.create_timer(WIRING_S, self.look_at_wiring, clock=steady)
        self._activity = HEARTBEAT.activity(f"{node_type.name} worker")
        self._worker = threading.Thread(target=self._work, name=f"{node_type.name} worker", daemon=True)
        self._worker.start()

    def close(self) -> int:
        """Process the queue, finish the handler, and send the last diagnostics; return the process's exit status."""
        with contextlib.suppress(queue.Full):
            self._inbox.put(None, timeout=2.0)
        self._worker.join(timeout=5.0)
        finished = not self._worker.is_alive() and self._guarded(lambda _: self.handler.finish(), None)
        self._diagnostics.publish()
        return 0 if finished else EX_IOERR

    def _offer(self, callback: Callable[[Any], None], message: Any) -> None:
        size, held = data_bytes(message), self._bytes_in - self._bytes_out
        try:
            if size and held and held + size > QUEUE_BYTES:  # a single message is always accepted
                raise queue.Full
            self._inbox.put_nowait((callback, message))
            self._bytes_in += size
            self.health.gauge("queue", self._inbox.unfinished_tasks)
        except queue.Full:
            queued = f"{self._inbox.qsize()} messages ({held >> 20} MB) are queued already"
            self.health.drop("overload", f"{queued}; reduce the frame rate or add cores")

    def _tick(self) -> None:
        self.state_listeners()
        # One is enough: while the worker is busy, more of them would take the places of messages.
        if self._tick_waits or self._inbox.full():
            return
        self._tick_waits = True
        self._offer(self._run_tick, None)

    def _run_tick(self, _: Any) -> None:
        now = time.monotonic()
        waited, self._last_tick, self._tick_waits = now - self._last_tick, now, False
        self.handler.tick(waited)

    def _work(self) -> None:
        while (item := self._inbox.get()) is not None:
            callback, message = item
            started, results = time.perf_counter(), self.health.results
            self._activity.begin("tick or request" if message is None else type(message).__name__)
            try:
                self._guarded(callback, message)
                if self._inbox.empty():
                    self._guarded(lambda _: self.handler.idle(), None)
            except BaseException:
                # An internal error: end the process at once with its traceback, and let the graph restart it.
                sys.excepthook(*sys.exc_info())
                os._exit(1)
            self._activity.end()
            # A message that only waits for others to join it takes no processing time.
            if self.health.results > results or not self.handler.publications:
                self.health.worked(time.perf_counter() - started)
            self._bytes_out += data_bytes(message)
            self._inbox.task_done()
            self.health.gauge("queue", self._inbox.unfinished_tasks)

    def _guarded(self, callback: Callable[[Any], None], message: Any) -> bool:
        """Run a callback; return False if it rejected the message."""
        try:
            callback(message)
        except LtmError as error:
            self.health.drop(cause_of(error), str(error))
            self.warn(str(error))
            return False
        return True

    def _serve(self, action: Callable[[], str]) -> Callable[[Any, Any], Any]:
        def answer(_: Any, response: Any) -> Any:
            """Run an action on the worker, between messages, because handlers use only one thread."""
            outcome: queue.Queue[tuple[bool, str]] = queue.Queue(1)

            def act(_: Any) -> None:
                self._activity.slow = True
                try:
                    outcome.put((True, action()))
                except LtmError as error:
                    outcome.put((False, str(error)))

            try:
                self._inbox.put((act, None), timeout=5.0)
                response.success, response.message = outcome.get(timeout=30.0)
            except (queue.Full, queue.Empty):
                response.success, response.message = False, "the node is too busy; try again"
            return response

        return answer


def run_node(node_type: NodeType[ConfigT], module: str = "__main__") -> None:
    """Run a node until SIGINT or SIGTERM, then process the queue and send a last report; does nothing if `module` is
    not the program itself.

    Exits with EX_CONFIG if the configuration is invalid, so that the graph does not restart it endlessly."""
    if module == "__main__":
        run_until_stopped(node_type.name, lambda: HandlerNode(node_type))
