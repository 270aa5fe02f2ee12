import time
from collections.abc import Callable, Iterator, Mapping
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Header

from ltm_core.base.errors import ConfigError
from ltm_ros.launching import site_process
from ltm_ros.launching.graph import NodeSpec
from ltm_ros.launching.site_process import LONGEST_PAUSE_S, SiteProcess
from ltm_ros.runtime.delivery_checks import NUMBER
from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.tower.tower_status import TowerWatch

IMAGE = Topic("/axis/image", Header, usual_name="image")
POSED = Topic("posed/image", Header)


class Camera(Handler[NodeConfig]):
    publications = (POSED,)
    without_dem: set[str] = set()  # noqa: RUF012 # set by the test

    def __init__(self, config: NodeConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        if config.camera in self.without_dem:
            raise ConfigError("moon.tif does not exist")

    @property
    def subscriptions(self) -> Mapping[Topic, Callable[[Any], None]]:
        return {IMAGE: lambda _: None}


NODE = NodeType("capture", NodeConfig, Camera)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], SiteProcess]]:
    monkeypatch.setattr(site_process, "load_site", lambda path: SimpleNamespace(workers=1))
    monkeypatch.setattr(Camera, "without_dem", {"east"})
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    running: list[SiteProcess] = []

    def start() -> SiteProcess:
        specs = [
            NodeSpec("capture", f"/ridge/{camera}", __name__, {"site": "s.yaml", "camera": camera})
            for camera in ("north", "east")
        ]
        running.append(SiteProcess(specs))
        return running[0]

    rclpy.init()
    yield start
    for process in running:
        process.close()
        for node in process.members:
            node.destroy_node()
    rclpy.try_shutdown()


def test_a_camera_that_cannot_start_is_tried_again_and_leaves_no_node_meanwhile(
    started: Callable[[], SiteProcess], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    process = started()
    (north,) = process.members
    assert ("capture", "/ridge/east") not in north.get_node_names_and_namespaces()
    assert "/ridge/east: cannot start: moon.tif does not exist" in capsys.readouterr().err
    (said,) = process._not_started()
    assert said.name == "/ridge/east/capture"
    assert said.message == "cannot start: moon.tif does not exist; retrying later"
    watch = TowerWatch("ridge", ["/ridge/north/capture", said.name], 120.0)
    watch.hear(said.name, said.level != DiagnosticStatus.OK, said.message, {}, 1.0)
    east = watch.cameras(1.0, 1.0)[1]
    assert (east.state, east.wrong) == ("connecting", f"east: capture: {said.message}")
    for rounds, broken, members in ((1, True, 1), (2, True, 1), (3, False, 2)):
        monkeypatch.setattr(Camera, "without_dem", {"east"} if broken else set())
        later = time.monotonic() + rounds * (LONGEST_PAUSE_S + 1)
        monkeypatch.setattr(site_process, "time", SimpleNamespace(monotonic=lambda now=later: now))
        process._tick()
        assert len(process.members) == members
        assert (("capture", "/ridge/east") in north.get_node_names_and_namespaces()) is not broken
    assert process._not_started() == []
    assert capsys.readouterr().err.splitlines() == ["/ridge/east: started"], "the same reason is not repeated"


def test_frames_of_a_topic_with_another_name_are_counted(started: Callable[[], SiteProcess]) -> None:
    node: Any = started().members[0]
    _, _, take = node._reliable[IMAGE.name]
    take(Header(), {NUMBER: 1})
    assert node.health.summary()["frames_in"] == "1"
