"""Run the ROS side of a handler: a node with its parameters, publishers and subscriptions."""

import ast
import inspect
import itertools
import sys
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from ltm_core.base.strict_model import StrictModel
from ltm_core.storage.config_io import checked
from ltm_msgs_py.bag.schemas import message_class
from ltm_msgs_py.pose import POSE_TYPES
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.delivery_checks import LISTENERS, LossCounter, unheard, with_info
from ltm_ros.runtime.handler import ConfigT, NodeType, Topic
from ltm_ros.runtime.health import Health

WIRING_S = 5.0
"""Seconds between two checks for published topics that do not reach a node."""


def stream_qos(latched: bool = False, depth: int = 10) -> QoSProfile:
    """Return QoS: reliable, keep the last `depth`; latched topics keep the last message for late subscribers."""
    if latched:
        return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


class OutletNode(Node):  # type: ignore[misc]
    """A node that connects a handler to DDS (`Outlet`); subclasses run the handler.

    `given`: arguments of rclpy's Node that replace the command line."""

    def __init__(self, node_type: NodeType[ConfigT], given: Mapping[str, Any] | None = None) -> None:
        super().__init__(
            **{"node_name": node_type.name, "automatically_declare_parameters_from_overrides": True} | dict(given or {})
        )
        self.config: Any = read_parameters(self, node_type.config)
        self.health = Health()
        self._publishers_by_topic: dict[Topic, Any] = {}
        self._reliable: dict[str, tuple[Any, Topic, Callable[..., None]]] = {}
        """Subscriptions by absolute topic, with the function that takes messages."""
        self._unheard: dict[str, str] = {}
        self._undecided: dict[str, Callable[[type], None]] = {}
        """Functions that subscribe to a topic once its type is known, by the topic's name."""

    def publish(self, topic: Topic, message: Any) -> None:
        self.send(topic, message)
        if not topic.latched:
            self.health.published(topic.name, stamp_of(message), self.now_ns())

    def provide(self, topic: Topic, stamp_ns: int, make: Callable[[], Any]) -> None:
        if self.wanted(topic):
            self.send(topic, make())
        self.health.published(topic.name, stamp_ns, self.now_ns())

    def wanted(self, topic: Topic) -> bool:
        return bool(self._publishers_by_topic[topic].get_subscription_count() > 0)

    def more_waits(self) -> bool:
        return False

    def now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)  # 0: simulated time has not begun for this node

    def open(self, topic: Topic) -> None:
        """Create the publisher of `topic`."""
        quality = stream_qos(topic.latched, topic.depth)
        self._publishers_by_topic[topic] = self.create_publisher(topic.type, topic.name, quality)

    def send(self, topic: Topic, message: Any) -> None:
        """Publish to other processes, by DDS."""
        self._publishers_by_topic[topic].publish(message)

    def listen(self, topic: Topic, offer: Callable[[Any], None]) -> None:
        """Pass messages of a topic to `offer`; count received and lost ones."""
        name = topic.name
        losses = LossCounter(self, name, self.health)

        def take(message: Any, info: Any) -> None:
            if topic.counted:
                self.health.received(topic.counted_name)
            if not topic.latched:  # of these only the last message counts
                losses.take(info)
            offer(message)

        def subscribe(kind: type) -> None:
            callback = with_info(take)
            subscription = self.create_subscription(kind, name, callback, stream_qos(topic.latched, topic.depth))
            if not topic.latched:
                self._reliable[subscription.topic_name] = subscription, replace(topic, type=kind), callback

        if topic.any_pose:
            self._undecided[name] = subscribe
        else:
            subscribe(topic.type)

    def _settle_types(self) -> None:
        """Subscribe to topics of several accepted types once a publisher shows which."""
        for name, subscribe in list(self._undecided.items()):
            offered = {end.topic_type for end in self.get_publishers_info_by_topic(name)}
            if found := next((kind for kind in POSE_TYPES if kind in offered), None):
                del self._undecided[name]
                subscribe(message_class(found))
            elif offered:
                supported = ", ".join(POSE_TYPES)
                self.health.trouble("type", f"{name} has type {', '.join(sorted(offered))}; supported: {supported}")

    def state_listeners(self) -> None:
        """Report the number of subscribers of each publisher; called every half second."""
        self._settle_types()
        for topic, publisher in self._publishers_by_topic.items():
            self.health.gauge(LISTENERS + topic.name, publisher.get_subscription_count())

    def look_at_wiring(self) -> None:
        """Report published topics that do not reach this node, if that persists and is not for best effort."""
        former, self._unheard = self._unheard, unheard(self)
        for topic in former.keys() & self._unheard.keys():
            if not self._take_best_effort(topic):
                self.health.trouble("unmatched", self._unheard[topic])

    def _take_best_effort(self, topic: str) -> bool:
        """Subscribe with best effort if all publishers of a topic offer only that, as many camera drivers do. Return
        whether it was done: reliable messages lose nothing, so they are preferred."""
        offered = [end.qos_profile.reliability for end in self.get_publishers_info_by_topic(topic)]
        if topic not in self._reliable or set(offered) != {ReliabilityPolicy.BEST_EFFORT}:
            return False
        subscription, kind, callback = self._reliable.pop(topic)
        self.destroy_subscription(subscription)
        quality = QoSProfile(depth=kind.depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(kind.type, topic, callback, quality)
        self.health.note("best_effort")
        return True

    def warn(self, text: str) -> None:
        """Log a warning, at a limited rate."""
        self.get_logger().warning(text, throttle_duration_sec=5.0)


def read_parameters(node: Node, model: type[ConfigT]) -> ConfigT:
    """Read the node's parameters as typed configuration, and describe them; they are read-only from then on. Raises
    ConfigError, e.g. for unknown ones."""
    given = {
        name: parameter.value
        for name, parameter in node.get_parameters_by_prefix("").items()
        if name not in ("use_sim_time", "start_type_description_service") and not name.startswith("qos_overrides.")
    }
    config = checked(model, given, f"parameters of node {node.get_fully_qualified_name()}")
    texts = docstrings(model)
    for name, field in model.model_fields.items():
        described = _descriptor(field, texts.get(name, ""))
        if name in given:
            described.type = node.get_parameter(name).type_.value
            node.set_descriptor(name, described)
        elif field.default is not PydanticUndefined:
            value = getattr(config, name)
            known = isinstance(value, bool | int | float | str | list)
            node.declare_parameter(name, value if known else str(value), described)
    return config


def docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Return the docstrings of a class's fields. Pydantic looks at the files of all loaded modules for that."""
    found = {}
    for owner in reversed(model.__mro__):
        if issubclass(owner, StrictModel):
            (parsed,) = ast.parse(textwrap.dedent(inspect.getsource(owner))).body
            for field, text in itertools.pairwise(parsed.body if isinstance(parsed, ast.ClassDef) else ()):
                match field, text:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str() as said)):
                        found[name] = said
    return found


def _descriptor(field: FieldInfo, text: str) -> ParameterDescriptor:
    """Return description and limits of a parameter, as its configuration class states them."""
    described = ParameterDescriptor(description=" ".join(text.split()), read_only=True)
    low = [v for one in field.metadata if (v := getattr(one, "ge", getattr(one, "gt", None))) is not None]
    high = [v for one in field.metadata if (v := getattr(one, "le", getattr(one, "lt", None))) is not None]
    if (low or high) and field.annotation is int:
        least, most = int(max(low, default=-(2**63))), int(min(high, default=2**63 - 1))
        described.integer_range = [IntegerRange(from_value=least, to_value=most)]
    elif low or high:
        limit = sys.float_info.max
        bounds = float(max(low, default=-limit)), float(min(high, default=limit))
        described.floating_point_range = [FloatingPointRange(from_value=bounds[0], to_value=bounds[1])]
    return described
