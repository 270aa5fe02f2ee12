"""A handler that passes on what it hears, or does not come to an end with it: `python -m handler_for_tests`.

As `camera: talker` it says something each half second instead. Where `DEAF_ONCE` names a file that is not there, it
makes it, and hears nothing in this run.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from std_msgs.msg import Header

from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health
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


class Talker(Handler[NodeConfig]):
    publications = (HEARD,)

    def tick(self, waited: float) -> None:
        self.outlet.acknowledge(HEARD, 0)


def made(config: NodeConfig, outlet: Outlet, health: Health) -> Handler[NodeConfig]:
    return (Talker if config.camera == "talker" else Echo)(config, outlet, health)


def be_deaf_once(marker: str) -> None:
    """By being where nobody else of the graph is."""
    if marker and not Path(marker).exists() and "__node:=talker" not in sys.argv:
        Path(marker).touch()
        os.environ["ROS_DOMAIN_ID"] = str((int(os.environ["ROS_DOMAIN_ID"]) + 100) % 200)


if __name__ == "__main__":
    be_deaf_once(os.environ.get("DEAF_ONCE", ""))
    run_node(NodeType("echo", NodeConfig, made))
