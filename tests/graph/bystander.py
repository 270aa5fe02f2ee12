"""A participant beside the graph under test: it sends, listens, calls, and reads the diagnostics."""

import time
from collections import defaultdict
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from scenes.waiting import PATIENCE_S, wait_for
from std_srvs.srv import Trigger

from ltm_lab.spinning_node import SpinningNode
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.delivery_checks import unmatched, with_info
from ltm_ros.runtime.outlet_node import stream_qos


class Bystander(SpinningNode):
    """A context manager; its node spins in a thread of its own."""

    def __init__(self) -> None:
        super().__init__("bystander")
        self.heard: dict[str, list[Any]] = defaultdict(list)
        """Messages by topic, in the order of arrival."""
        self.summaries: dict[str, dict[str, str]] = {}
        """The last diagnostics of every node, by full name."""
        self._senders: dict[str, Any] = {}
        self._since_ns = 0
        self.node.create_subscription(DiagnosticArray, "/diagnostics", with_info(self._diagnosed), 200)

    def listen(self, topic: str, message_type: type, latched: bool = False, depth: int = 10) -> None:
        """Keep what comes on `topic`, an absolute name."""
        self.node.create_subscription(message_type, topic, self.heard[topic].append, stream_qos(latched, depth))

    def open(self, topic: str, message_type: type, listeners: int = 1, latched: bool = False) -> None:
        """Prepare to send on `topic`; waits until so many listen."""
        sender = self._senders[topic] = self.node.create_publisher(message_type, topic, stream_qos(latched))
        wait_for(lambda: sender.get_subscription_count() >= listeners, f"{listeners} listeners on {topic}")

    def send(self, topic: str, message: Any) -> None:
        """A message, or the bytes of one, on a topic that is open."""
        self._senders[topic].publish(message)

    def stamps(self, topic: str) -> list[int]:
        """Stamps of what came on `topic`."""
        return [stamp_of(message) for message in list(self.heard[topic])]

    def wait_for_stamp(self, topic: str, stamp_ns: int) -> Any:
        """The message of that stamp on `topic`."""
        wait_for(lambda: stamp_ns in self.stamps(topic), f"stamp {stamp_ns} on {topic}", lambda: self.summaries)
        return self.heard[topic][self.stamps(topic).index(stamp_ns)]

    def forget(self) -> None:
        """The diagnostics so far, with those that are still on their way: of a node that was killed a moment ago."""
        self._since_ns = time.time_ns()
        self.summaries = {}

    def count(self, node: str, key: str) -> int:
        """A counter of a node's diagnostics; 0 where it is not there."""
        return int(self.summaries.get(node, {}).get(key, "0"))

    def dropped(self, node: str) -> dict[str, int]:
        """What a node has dropped so far, by cause."""
        summary = self.summaries[node]
        drops = {k.partition(".")[2]: int(v) for k, v in summary.items() if k.startswith("dropped.")}
        assert sum(drops.values()) == int(summary.get("dropped", "0"))
        return drops

    def wait_for_wiring(self, nodes: int) -> None:
        """Until so many nodes have reported and all of them are matched with all that listen to them, this one too."""

        def loose() -> list[str]:
            return unmatched(self.node, {**self.summaries, self.node.get_fully_qualified_name(): {}})

        wait_for(
            lambda: len(self.summaries) >= nodes and not loose(),
            f"{nodes} nodes that have found each other",
            lambda: (self.summaries.keys(), loose()),
        )

    def call(self, service: str) -> tuple[bool, str]:
        """Call a Trigger service: its success and its message."""
        client = self.node.create_client(Trigger, service)
        assert client.wait_for_service(PATIENCE_S), service
        answer = client.call_async(Trigger.Request())
        wait_for(answer.done, f"an answer of {service}")
        self.node.destroy_client(client)
        return bool(answer.result().success), str(answer.result().message)

    def _diagnosed(self, message: Any, info: Any) -> None:
        summaries = self.summaries
        if info["source_timestamp"] >= self._since_ns:
            for status in message.status:
                summaries[status.name] = {item.key: item.value for item in status.values}
