"""Run the ROS side of a handler: a node with its parameters, publishers and subscriptions."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Set
from types import TracebackType
from typing import Any, Self

import rclpy
from pydantic_core import PydanticUndefined
from rcl_interfaces.msg import SetParametersResult
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from ltm_core.storage.config_io import checked
from ltm_msgs_py.stamp import make_header, stamp_of
from ltm_ros.runtime.clocks import ClockWatch
from ltm_ros.runtime.delivery_checks import LISTENERS, LossCounter, loss_report, unheard, with_info, writers_of
from ltm_ros.runtime.handler import ConfigT, NodeType, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.heartbeat import TRAFFIC, TopicCount
from ltm_ros.runtime.ros_environment import wait_for_quiet

WIRING_S = 5.0
"""Seconds between two checks for published topics that do not reach a node."""


def stream_qos(latched: bool = False, depth: int = 10) -> QoSProfile:
    """Return QoS: reliable, keep the last `depth`; latched topics keep the last message for late subscribers."""
    if latched:
        return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def _qos(topic: Topic) -> QoSProfile:
    return stream_qos(topic.latched, topic.depth)


class OutletNode(Node):  # type: ignore[misc]
    """A node that connects a handler to DDS (`Outlet`); subclasses run the handler.

    `given`: arguments of rclpy's Node that replace the command line.
    """

    def __init__(self, node_type: NodeType[ConfigT], given: Mapping[str, Any] | None = None) -> None:
        super().__init__(
            **{"node_name": node_type.name, "automatically_declare_parameters_from_overrides": True} | dict(given or {})
        )
        self.config: Any = read_parameters(self, node_type.config)
        self.health = Health()
        self._publishers_by_topic: dict[Topic, Any] = {}
        self._said: dict[Topic, TopicCount] = {}
        self._heard: list[TopicCount] = []
        self._clock_watch = ClockWatch()
        self._unheard: dict[str, str] = {}

    def publish(self, topic: Topic, message: Any) -> None:
        """Implement Outlet."""
        self.send(topic, message)
        if not topic.latched:
            self._count(topic, stamp_of(message))

    def provide(self, topic: Topic, stamp_ns: int, make: Callable[[], Any]) -> None:
        """Implement Outlet."""
        if self.wanted(topic):
            self.send(topic, make())
        self._count(topic, stamp_ns)

    def wanted(self, topic: Topic) -> bool:
        """Implement Outlet."""
        return bool(self._publishers_by_topic[topic].get_subscription_count() > 0)

    def more_waits(self) -> bool:
        """Implement Outlet."""
        return False

    def now_ns(self) -> int:
        """Implement Outlet."""
        return int(self.get_clock().now().nanoseconds)

    def acknowledge(self, topic: Topic, stamp_ns: int) -> None:
        """Implement Outlet."""
        self.send(topic, self.acknowledgement(stamp_ns))

    def workers(self, topic: Topic) -> Set[str]:
        """Implement Outlet."""
        ends = self.get_publishers_info_by_topic(topic.name)
        # DDS does not know the name of a new endpoint yet.
        return {f"{end.node_namespace.rstrip('/')}/{end.node_name}" for end in ends if "UNKNOWN" not in end.node_name}

    def prompt_workers(self, topic: Topic) -> Set[str]:
        """Implement Outlet."""
        return frozenset()

    def acknowledgement(self, stamp_ns: int) -> Any:
        return make_header(stamp_ns, self.get_fully_qualified_name())

    def open(self, topic: Topic) -> None:
        """Create the publisher of `topic`."""
        publisher = self._publishers_by_topic[topic] = self.create_publisher(topic.type, topic.name, _qos(topic))
        if not topic.latched:
            self._said[topic] = TRAFFIC.speaker(publisher.topic_name)

    def send(self, topic: Topic, message: Any) -> None:
        """Publish to other processes, by DDS."""
        self._publishers_by_topic[topic].publish(message)
        if (said := self._said.get(topic)) is not None:
            said.messages += 1

    def listen(self, topic: Topic, name: str, offer: Callable[[Any], None]) -> None:
        """Pass messages of the named topic to `offer`; lost messages are counted."""
        losses = LossCounter(writers_of(self, name))
        heard = TRAFFIC.listener(self.resolve_topic_name(name))
        self._heard.append(heard)

        def take(message: Any, info: Any) -> None:
            heard.messages += 1
            # For a latched topic only the last message counts.
            if not topic.latched and (lost := losses.lost(info)):
                self.health.drop("lost", loss_report(lost, name), lost)
            offer(message)

        self.create_subscription(topic.type, name, with_info(take), _qos(topic))

    def destroy_node(self) -> None:
        TRAFFIC.forget([*self._said.values(), *self._heard])
        super().destroy_node()

    def state_listeners(self) -> None:
        """Report the number of subscribers of each publisher."""
        for topic, publisher in self._publishers_by_topic.items():
            self.health.gauge(LISTENERS + topic.name, publisher.get_subscription_count())

    def look_at_clock(self) -> None:
        """Report if the system clock was set."""
        step = self._clock_watch.step_s()
        if step and not self.get_parameter("use_sim_time").value:
            self.health.note("clock_step")
            self.health.trouble(
                "clock_step",
                f"the system clock was set by {step:+.1f} s; earlier frames may appear early or late",
            )

    def look_at_wiring(self) -> None:
        """Report published topics that do not reach this node, if that persists."""
        former, self._unheard = self._unheard, unheard(self)
        for topic in former.keys() & self._unheard.keys():
            self.health.trouble("unmatched", self._unheard[topic])

    def warn(self, text: str) -> None:
        """Log a warning, at a limited rate."""
        self.get_logger().warning(text, throttle_duration_sec=5.0)

    def _count(self, topic: Topic, stamp_ns: int) -> None:
        self.health.published(topic.name, stamp_ns, self.now_ns())  # 0: simulated time has not begun for this node


def read_parameters(node: Node, model: type[ConfigT]) -> ConfigT:
    """Read the node's parameters as typed configuration, fixed from then on. Raises ConfigError, e.g. for
    unknown ones.
    """
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
            reason=f"{changed}: cannot be changed while the node runs; change the site file" if changed else "",
        )

    node.add_on_set_parameters_callback(refuse)
    return config


def _ros_value(value: object) -> object:
    return value if isinstance(value, bool | int | float | str | list) else str(value)


class SpinningNode:
    """Spins `node` in a thread; callbacks come on that thread. A context manager."""

    def __init__(self, name: str) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = Node(name, context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._thread.join()
        self._executor.shutdown()
        wait_for_quiet(self.node)
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _spin(self) -> None:
        while not self._stopping.is_set():
            self._executor.spin_once(timeout_sec=0.1)
