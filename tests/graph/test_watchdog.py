"""A real node that hears nothing is killed and started again, and then passes on messages.

Run as a program, `python -m test_watchdog`, this file is such a node. With `camera: talker` it sends a message each
half second instead.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import pytest
from bystander import Bystander
from scenes.small_site import NAME, SmallSite
from scenes.waiting import wait_for
from std_msgs.msg import Header

from ltm_core.site.sections import WatchdogConfig
from ltm_ros.launching.graph import Graph, NodeSpec
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node

pytestmark = pytest.mark.graph

HEARD, SAID = Topic("heard", Header), Topic("said", Header, latched=True)
DEAF = WatchdogConfig(silent=20.0, deaf=10.0)


class Echo(Handler[NodeConfig]):
    publications = (SAID,)

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {HEARD: self.on_message}

    def on_message(self, message: Any) -> None:
        self.outlet.publish(SAID, message)


class Talker(Handler[NodeConfig]):
    publications = (HEARD,)

    def tick(self, waited: float) -> None:
        cast(Any, self.outlet).send(HEARD, Header())


def made(config: NodeConfig, outlet: Outlet, health: Health) -> Handler[NodeConfig]:
    return (Talker if config.camera == "talker" else Echo)(config, outlet, health)


def running(domain: int, nodes: tuple[NodeSpec, ...], limits: WatchdogConfig, lines: list[str], marker: str) -> Runner:
    environment = {"PYTHONPATH": os.pathsep.join(sys.path), "DEAF_ONCE": marker}
    policy = RestartPolicy(initial_s=0.1, maximum_s=0.4)
    graph = Graph(NAME, nodes, limits)
    return Runner(graph, domain_id=domain, console=lines.append, policy=policy, environment=environment)


def test_a_node_that_hears_nothing_is_started_again(small_site: SmallSite, ros_domain: int, tmp_path: Path) -> None:
    parameters = {"site": str(small_site.path)}
    talker = NodeSpec("talker", f"/{NAME}", "test_watchdog", parameters | {"camera": "talker"})
    echo = NodeSpec("echo", f"/{NAME}", "test_watchdog", parameters)
    lines: list[str] = []
    marker = str(tmp_path / "deaf")
    with running(ros_domain, (talker, echo), DEAF, lines, marker) as runner, Bystander() as bystander:
        said = f"{echo.namespace}/{SAID.name}"
        bystander.listen(said, SAID.type, latched=True)
        wait_for(lambda: bystander.heard[said], "what it passes on", lambda: lines, 120.0)
        assert runner.processes["echo"].hangs >= 1
        assert runner.processes["talker"].starts == 1, "a node that no other sends to is not deaf"


if __name__ == "__main__":
    marker = Path(os.environ["DEAF_ONCE"])
    if marker.name and not marker.exists() and "__node:=talker" not in sys.argv:
        marker.touch()  # this run is in another domain, where no message of the graph arrives
        os.environ["ROS_DOMAIN_ID"] = str((int(os.environ["ROS_DOMAIN_ID"]) + 100) % 200)
    run_node(NodeType("echo", NodeConfig, made))
