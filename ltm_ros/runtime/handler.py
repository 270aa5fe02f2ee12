"""Define the base class of nodes without transport: subscriptions, publications, services and their callbacks.

The live node (`runtime.node`) and the offline replay (`replay.offline`) feed the same handlers with the same messages,
so that a recording gives the tower's results."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from ltm_core.base.strict_model import StrictModel
from ltm_ros.runtime.health import Health


@dataclass(frozen=True)
class Topic:
    """`name`: relative to the node's namespace, or absolute. `latched`: late subscribers get the last message. `depth`:
    messages kept for a slow subscriber. `counted`: whether messages count as frames received, under `usual_name` if
    the site file gives the topic another one. `any_pose`: messages of the other types of poses are accepted, too."""

    name: str
    type: type
    latched: bool = False
    depth: int = 10
    counted: bool = True
    usual_name: str = ""
    any_pose: bool = False

    @property
    def counted_name(self) -> str:
        return self.usual_name or self.name

    def under(self, namespace: str) -> str:
        """Return the absolute name in a namespace."""
        return self.name if self.name.startswith("/") else f"{namespace}/{self.name}"


class NodeConfig(StrictModel):
    """Parameters of every node."""

    site: str
    """Path of the site file."""
    camera: str = ""
    """Name of the node's camera in the site; empty for nodes of the whole site."""

    def beside_site(self, folder: str) -> Path | None:
        """Return a folder that is relative to the site file; None if it is empty."""
        return Path(self.site).parent / Path(folder).expanduser() if folder else None


class Outlet(Protocol):
    """Transport of a handler's messages."""

    def publish(self, topic: Topic, message: Any) -> None: ...

    def provide(self, topic: Topic, stamp_ns: int, make: Callable[[], Any]) -> None:
        """Publish the result of `make` for a frame of this stamp if the topic has subscribers; otherwise
        only count it."""

    def wanted(self, topic: Topic) -> bool:
        """Return whether the topic has subscribers. Expensive messages are built only if it has."""

    def more_waits(self) -> bool:
        """Return whether this handler gets further messages at once, and then `idle`."""

    def now_ns(self) -> int:
        """Return the graph's time for checking stamps: ROS time, or the recording's; 0 before it begins."""


ConfigT = TypeVar("ConfigT", bound=NodeConfig)


class Handler(Generic[ConfigT]):
    """Base of the handlers: subclasses fill `subscriptions`, `publications` and, if needed, `services`.

    All callbacks run on one thread, in order of arrival. A callback may raise LtmError: the message is dropped and
    counted by cause, and the node continues."""

    publications: Sequence[Topic] = ()

    def __init__(self, config: ConfigT, outlet: Outlet, health: Health) -> None:
        self.config = config
        self.outlet = outlet
        self.health = health

    @property
    def subscriptions(self) -> Mapping[Topic, Callable[[Any], None]]:
        """Return the topics to subscribe to, with their callbacks."""
        return {}

    @property
    def services(self) -> Mapping[str, Callable[[], str]]:
        """Return std_srvs/Trigger services by name; each returns its answer or raises LtmError."""
        return {}

    def start(self) -> None:
        """Publish latched messages; called once when publications are open."""

    def idle(self) -> None:
        """Do work that is cheaper in batches; called after a message when no other waits."""

    def discard(self, stamp_ns: int) -> None:
        """Forget the waiting parts of a camera's frame that will not be completed."""

    def tick(self, waited: float) -> None:
        """Advance time; called every half second with the seconds since the last call, by a clock that also runs in a
        paused replay."""

    def end_of_day(self) -> None:
        """Publish periodic results at a change of the UTC day in an offline replay, which has no clock."""

    def finish(self) -> None:
        """Finish; called once when no more messages come."""


@dataclass(frozen=True)
class NodeType(Generic[ConfigT]):
    """Description of a node module, its `NODE`: name, parameters and handler."""

    name: str
    config: type[ConfigT]
    handler: Callable[[ConfigT, Outlet, Health], Handler[ConfigT]]


EX_CONFIG = 78
"""Exit status of a node with an invalid configuration (sysexits.h)."""
