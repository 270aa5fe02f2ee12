"""A handler that passes on what it hears, or does not come to an end with it: `python -m handler_for_tests`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from std_msgs.msg import Header

from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Topic
from ltm_ros.runtime.node import run_node

HEARD, SAID = Topic("heard", Header), Topic("said", Header, latched=True)
BLOCK, SPIN = "block", "spin"
"""Frame ids of messages that it never comes to an end with."""


class Echo(Handler[NodeConfig]):
    publications = (SAID,)

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {HEARD: self.on_message}

    def on_message(self, message: Any) -> None:
        if message.frame_id == BLOCK:
            threading.Event().wait()
        while message.frame_id == SPIN:
            pass
        self.outlet.publish(SAID, message)


if __name__ == "__main__":
    run_node(NodeType("echo", NodeConfig, Echo))
