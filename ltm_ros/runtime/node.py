"""The live side of a handler: an rclpy node that passes messages to it and publishes its results."""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Set
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

from pydantic_core import PydanticUndefined
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from ltm_core.config_io import checked
from ltm_core.errors import LtmError
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.stamp import make_header, stamp_of
from ltm_ros.runtime.clock_watch import ClockWatch
from ltm_ros.runtime.diagnostics import DiagnosticsPublisher
from ltm_ros.runtime.discovery_check import LISTENERS, unheard
from ltm_ros.runtime.handler import ConfigT, NodeType, Topic
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.heartbeat import HEARTBEAT
from ltm_ros.runtime.message_loss import LossCounter, loss_report, writers_of
from ltm_ros.runtime.node_process import EX_IOERR, run_until_stopped

QUEUE = 30
QUEUE_PER_TOPIC = 10
"""Messages that wait for a busy handler before the newest is dropped and counted: the greater of the two bounds, for a
frame brings a message on each topic."""
QUEUE_BYTES = 512 << 20
"""Bytes of image data that wait at most: the viewer of twenty towers shall not fill the memory."""
WIRING_S = 5.0
DISCOVERED = 10_000
"""Topics found by pattern that a node listens to at most: nobody shall fill its memory with names."""


def stream_qos(latched: bool = False, depth: int = 10) -> QoSProfile:
    """Reliable, keeps the last `depth`; latched topics keep the last one for late joiners."""
    if latched:
        return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def _qos(topic: Topic) -> QoSProfile:
    return stream_qos(topic.latched, topic.depth)


_Item = tuple[Callable[[Any], None], Any]


class _Inbox(queue.Queue[_Item | None]):
    """Callbacks with their messages; full when there are too many of them, or when they hold too many bytes."""

    def __init__(self, messages: int, most_bytes: int) -> None:
        super().__init__(messages)
        self._most_bytes = most_bytes
        self._bytes_in = self._bytes_out = 0  # each written by one thread only

    @property
    def waiting_bytes(self) -> int:
        return self._bytes_in - self._bytes_out

    def offer(self, callback: Callable[[Any], None], message: Any) -> None:
        """Raises queue.Full at once where there is no room. A message alone always has room."""
        size = _data_bytes(message)
        if size and self.waiting_bytes and self.waiting_bytes + size > self._most_bytes:
            raise queue.Full
        self.put_nowait((callback, message))
        self._bytes_in += size

    def done(self, message: Any) -> None:
        """The worker has finished with a message that was offered."""
        self._bytes_out += _data_bytes(message)
        self.task_done()


def _data_bytes(message: Any) -> int:
    return len(getattr(message, "data", ()))


class HandlerNode(Node):  # type: ignore[misc]
    """Runs one handler: messages queue up for a worker thread, so that the middleware is drained while it works."""

    def __init__(self, node_type: NodeType[ConfigT]) -> None:
        super().__init__(node_type.name, automatically_declare_parameters_from_overrides=True)
        config = read_parameters(self, node_type.config)
        self.health = Health()
        self._publishers_by_topic: dict[Topic, Any] = {}
        self._last_tick = time.monotonic()
        self._clock_watch = ClockWatch()
        self._results = 0
        self.handler = node_type.handler(config, self, self.health)
        self._taken: set[str] = set()
        self._inbox = _Inbox(QUEUE, QUEUE_BYTES)
        for topic in self.handler.publications:
            self._publishers_by_topic[topic] = self.create_publisher(topic.type, topic.name, _qos(topic))
        self.handler.start()
        for topic, callback in self.handler.subscriptions.items():
            self._listen(topic, topic.name, callback)
        if self.handler.discoverable:
            self.create_timer(0.5, self._discover, clock=DiagnosticsPublisher.steady_clock())
        for service, action in self.handler.services.items():
            self.create_service(Trigger, service, self._serve(action))
        # After the subscriptions: who is known to acknowledge frames also takes them.
        for topic in self.handler.acknowledgements:
            self._publishers_by_topic[topic] = self.create_publisher(topic.type, topic.name, _qos(topic))
        self._diagnostics = DiagnosticsPublisher(self, self.health, config.camera)
        self.create_timer(0.5, self._tick, clock=DiagnosticsPublisher.steady_clock())
        self._unheard: dict[str, str] = {}
        self.create_timer(WIRING_S, self._look_at_wiring, clock=DiagnosticsPublisher.steady_clock())
        self._activity = HEARTBEAT.activity(f"{node_type.name} worker")
        self._worker = threading.Thread(target=self._work, name=f"{node_type.name} worker", daemon=True)
        self._worker.start()

    def publish(self, topic: Topic, message: Any) -> None:
        """Part of Outlet."""
        self._publishers_by_topic[topic].publish(message)
        if not topic.latched:
            self._results += 1
            now = self.now_ns()
            # 0: simulated time that has not begun for this node, so nothing is known of the age.
            self.health.published(topic.name, (now - stamp_of(message)) / 1e9 if now else None)

    def wanted(self, topic: Topic) -> bool:
        """Part of Outlet."""
        return bool(self._publishers_by_topic[topic].get_subscription_count() > 0)

    def now_ns(self) -> int:
        """Part of Outlet."""
        return int(self.get_clock().now().nanoseconds)

    def acknowledge(self, topic: Topic, stamp_ns: int) -> None:
        """Part of Outlet."""
        self._publishers_by_topic[topic].publish(make_header(stamp_ns, self.get_fully_qualified_name()))

    def workers(self, topic: Topic) -> Set[str]:
        """Part of Outlet."""
        ends = self.get_publishers_info_by_topic(topic.name)
        # Of one that has just come DDS does not know the name yet.
        return {f"{end.node_namespace.rstrip('/')}/{end.node_name}" for end in ends if "UNKNOWN" not in end.node_name}

    def close(self) -> int:
        """Let the worker finish what waits, tell the handler, send the last diagnostics; the process's exit status."""
        with contextlib.suppress(queue.Full):
            self._inbox.put(None, timeout=2.0)
        self._worker.join(timeout=5.0)
        finished = not self._worker.is_alive() and self._guarded(lambda _: self.handler.finish(), None)
        self._diagnostics.publish()
        return 0 if finished else EX_IOERR

    def _listen(self, topic: Topic, name: str, callback: Callable[[Any], None]) -> None:
        self._taken.add(self.resolve_topic_name(name))
        self._inbox.maxsize = max(QUEUE, QUEUE_PER_TOPIC * len(self._taken))
        self.create_subscription(topic.type, name, self._enqueue(topic, name, callback), _qos(topic))

    def _discover(self) -> None:
        """Listen to topics that have appeared and fit a pattern of the handler's."""
        for name, types in self.get_topic_names_and_types():
            if name in self._taken or len(self._taken) >= DISCOVERED:
                continue
            for topic, callback in self.handler.discoverable.items():
                if name.count("/") == topic.name.count("/") and fnmatchcase(name, topic.name):
                    if types == [type_name_of(topic.type())]:
                        self._listen(topic, name, partial(callback, name))
                    break

    def _enqueue(self, topic: Topic, name: str, callback: Callable[[Any], None]) -> Callable[[Any, Any], None]:
        losses = LossCounter(writers_of(self, name))

        def take(message: Any, info: Any) -> None:
            if topic.counted:
                self.health.received(name)
            # Of a latched topic only the last message counts.
            if not topic.latched and (lost := losses.lost(info)):
                self.health.drop("lost", loss_report(lost, name), lost)
            self._offer(callback, message)

        return take

    def _offer(self, callback: Callable[[Any], None], message: Any) -> None:
        try:
            self._inbox.offer(callback, message)
            self.health.gauge("queue", self._inbox.unfinished_tasks)
        except queue.Full:
            self.health.drop(
                "overload",
                f"{self._inbox.qsize()} messages ({self._inbox.waiting_bytes >> 20} MB) wait already; "
                "slow the camera down or give it more cores",
            )

    def _tick(self) -> None:
        for topic, publisher in self._publishers_by_topic.items():
            self.health.gauge(LISTENERS + topic.name, publisher.get_subscription_count())
        self._look_at_clock()
        if self._inbox.full():
            return
        now = time.monotonic()
        waited, self._last_tick = now - self._last_tick, now
        self._offer(lambda _: self.handler.tick(waited), None)

    def _look_at_clock(self) -> None:
        step = self._clock_watch.step_s()
        if step and not self.get_parameter("use_sim_time").value:
            self.health.note("clock_step")
            self.health.trouble(
                "clock_step",
                f"this machine's clock was set by {step:+.1f} s; frames from before may look early or late",
            )

    def _look_at_wiring(self) -> None:
        """Tell of topics that somebody publishes and that do not reach this node, once that has lasted."""
        former, self._unheard = self._unheard, unheard(self)
        for topic in former.keys() & self._unheard.keys():
            self.health.trouble("unmatched", self._unheard[topic])

    def _work(self) -> None:
        while (item := self._inbox.get()) is not None:
            callback, message = item
            started, results = time.perf_counter(), self._results
            self._activity.begin("tick or request" if message is None else type(message).__name__)
            try:
                self._guarded(callback, message)
                if self._inbox.empty():
                    self._guarded(lambda _: self.handler.idle(), None)
            except BaseException:
                # A bug: end the whole process at once, with its traceback, and let the graph restart it.
                sys.excepthook(*sys.exc_info())
                os._exit(1)
            self._activity.end()
            # A message that only waits for others to join it tells nothing of the work on a frame.
            if self._results > results or not self.handler.publications:
                self.health.worked(time.perf_counter() - started)
            self._inbox.done(message)
            self.health.gauge("queue", self._inbox.unfinished_tasks)

    def _guarded(self, callback: Callable[[Any], None], message: Any) -> bool:
        """False where the message was refused."""
        try:
            callback(message)
        except LtmError as error:
            self.health.drop(cause_of(error), str(error))
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return False
        return True

    def _serve(self, action: Callable[[], str]) -> Callable[[Any, Any], Any]:
        def answer(_: Any, response: Any) -> Any:
            """Runs the action on the worker, between messages: handlers know one thread only."""
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


def read_parameters(node: Node, model: type[ConfigT]) -> ConfigT:
    """The node's parameters as typed configuration, fixed from here on. Raises ConfigError, e.g. on unknown ones."""
    given = {
        name: parameter.value
        for name, parameter in node.get_parameters_by_prefix("").items()
        if name not in ("use_sim_time", "start_type_description_service") and not name.startswith("qos_overrides.")
    }
    config = checked(model, given, f"parameters of node {node.get_fully_qualified_name()}")
    for name, field in model.model_fields.items():
        if name not in given and field.default is not PydanticUndefined:
            node.declare_parameter(name, _ros_value(getattr(config, name)))

    def refuse(parameters: list[Parameter]) -> SetParametersResult:
        changed = ", ".join(p.name for p in parameters if p.name in model.model_fields)
        return SetParametersResult(
            successful=not changed,
            reason=f"{changed}: fixed while the node runs; change the site file" if changed else "",
        )

    node.add_on_set_parameters_callback(refuse)
    return config


def _ros_value(value: object) -> object:
    return value if isinstance(value, bool | int | float | str | list) else str(value)


def run_node(node_type: NodeType[ConfigT]) -> None:
    """Body of every node's `main`: spin until SIGINT or SIGTERM, then finish what waits and send a last report.

    Exits with EX_CONFIG where the configuration cannot work, so that the graph does not start it for ever.
    """
    run_until_stopped(node_type.name, lambda: HandlerNode(node_type))
