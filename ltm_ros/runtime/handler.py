"""Base class of the nodes' work, without transport: subscriptions, publications, services and their callbacks.

The live node (`runtime.node`) and the offline replay (`replay.offline`) feed the same handlers with the same
messages, so what a tower computes live is what a researcher recomputes from the recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from ltm_core.base.strict_model import StrictModel
from ltm_ros.runtime.health import Health


@dataclass(frozen=True)
class Topic:
    """`name`: relative to the node's namespace, or absolute. `latched`: late joiners get the last message. `depth`:
    messages kept for a listener that is slow. `counted`: whether messages count as frames that a node receives.
    """

    name: str
    type: type
    latched: bool = False
    depth: int = 10
    counted: bool = True


class NodeConfig(StrictModel):
    """Parameters that every node takes."""

    site: str
    """Path of the site file."""
    camera: str = ""
    """Name of the node's camera in the site; empty for nodes of the whole site."""


class Outlet(Protocol):
    """Where a handler's messages go."""

    def publish(self, topic: Topic, message: Any) -> None: ...

    def provide(self, topic: Topic, stamp_ns: int, make: Callable[[], Any]) -> None:
        """Publish what `make` gives, of a frame of this stamp, where somebody listens; else it is only counted."""
        ...

    def wanted(self, topic: Topic) -> bool:
        """Whether somebody listens: costly messages are made only then."""
        ...

    def more_waits(self) -> bool:
        """Whether this handler gets further messages at once, and then `idle`."""
        ...

    def now_ns(self) -> int:
        """The graph's time, for judging stamps: ROS time, or that of the recording; 0 where it has not begun."""
        ...

    def acknowledge(self, topic: Topic, stamp_ns: int) -> None:
        """Say that this node has finished a camera's frame; `topic` is one of the handler's `acknowledgements`."""
        ...

    def workers(self, topic: Topic) -> Set[str]:
        """Full names of the nodes that acknowledge frames on a topic, as known now; none where frames are fed one by
        one."""
        ...

    def prompt_workers(self, topic: Topic) -> Set[str]:
        """Those of `workers` that by the next `idle` have done all that they will do with what was published before:
        nodes that share this one's process."""
        ...


ConfigT = TypeVar("ConfigT", bound=NodeConfig)


class Handler(Generic[ConfigT]):
    """Base of the handlers: subclasses fill `subscriptions`, `publications` and, where needed, `services`.

    All callbacks run on one thread, in order of arrival. A callback may raise LtmError: the message is dropped, the
    drop is counted by its cause, and the node lives on.
    """

    publications: Sequence[Topic] = ()
    acknowledgements: Sequence[Topic] = ()
    """Where this node says which frames it has finished, so that no more are let in than it can do; live only."""

    def __init__(self, config: ConfigT, outlet: Outlet, health: Health) -> None:
        self.config = config
        self.outlet = outlet
        self.health = health

    @property
    def subscriptions(self) -> Mapping[Topic, Callable[[Any], None]]:
        """What to listen to, and who takes each message."""
        return {}

    @property
    def discoverable(self) -> Mapping[Topic, Callable[[str, Any], None]]:
        """Topics to listen to as they appear, by patterns such as `/ridge/*/fuel/votes`; live only.

        `*` stands for one part of the name; the callback is told the whole name.
        """
        return {}

    @property
    def services(self) -> Mapping[str, Callable[[], str]]:
        """std_srvs/Trigger services by name; each returns its answer or raises LtmError."""
        return {}

    def start(self) -> None:
        """Called once when publications are open: latched messages go out here."""

    def idle(self) -> None:
        """Called after a message when no other waits: what is cheaper for many at once is done here."""

    def discard(self, stamp_ns: int) -> None:
        """Called where no more will come of a camera's frame: forget its parts that wait."""

    def tick(self, waited: float) -> None:
        """Called every half second with the seconds since the last call, on a clock that a replay does not stop."""

    def end_of_day(self) -> None:
        """Called in an offline replay, in which no time passes, where the recording goes over to another day, UTC:
        what live goes out now and then is said at least then."""

    def finish(self) -> None:
        """Called once when no more messages will come."""


@dataclass(frozen=True)
class NodeType(Generic[ConfigT]):
    """What a node module offers as `NODE`: its name, its parameters and its work."""

    name: str
    config: type[ConfigT]
    handler: Callable[[ConfigT, Outlet, Health], Handler[ConfigT]]


EX_CONFIG = 78
"""Exit status of a node whose configuration cannot work (sysexits.h)."""
