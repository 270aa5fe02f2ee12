"""An outlet that keeps what a handler sends."""

from collections.abc import Callable
from typing import Any

from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.handler import Topic


class Kept:
    """`wants`: topics that somebody would listen to."""

    def __init__(self, *wants: Topic) -> None:
        self.sent: list[tuple[Topic, Any]] = []
        self.now = 0
        """Set it where the graph's time matters."""
        self.more = False
        """Whether the handler gets further messages before it is idle."""
        self._wants = wants

    def wants(self, *topics: Topic) -> None:
        self._wants = topics

    def publish(self, topic: Topic, message: Any) -> None:
        self.sent.append((topic, message))

    def provide(self, topic: Topic, stamp_ns: int, make: Callable[[], Any]) -> None:
        """Everything is kept, so everything is made."""
        self.sent.append((topic, make()))

    def more_waits(self) -> bool:
        return self.more

    def now_ns(self) -> int:
        return self.now

    def wanted(self, topic: Topic) -> bool:
        return topic in self._wants

    def on(self, topic: Topic) -> list[Any]:
        return [message for sent, message in self.sent if sent == topic]

    def stamps(self, topic: Topic) -> list[int]:
        return [stamp_of(message) for message in self.on(topic)]
