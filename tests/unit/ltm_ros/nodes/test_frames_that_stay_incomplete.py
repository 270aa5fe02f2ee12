"""A frame whose other parts never come is given up by its age and counted with what it lacked, wherever nodes join.

When a node of its camera hangs, no newer frame pushes it out for long where a camera sends one a minute.
"""

from __future__ import annotations

from typing import Any

import pytest
from scenes.outlets import Kept
from scenes.small_site import BEGIN_NS, NAME, SmallSite
from scenes.terrain_frames import write_terrain_site

from ltm_core.geometry.pose import Pose
from ltm_msgs_py.pose import pose_to_msg
from ltm_ros.nodes.depth import DepthConfig, DepthHandler
from ltm_ros.nodes.terrain import TerrainHandler, TerrainNodeConfig
from ltm_ros.runtime.handler import Handler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import POSED_POSE, camera_topic


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    return write_terrain_site(tmp_path_factory.mktemp("site"))


def given_up(handler: Handler[Any], health: Health, max_wait: float) -> dict[str, str]:
    """What is counted of a frame of which only the pose comes."""
    listens = {topic.name: callback for topic, callback in handler.subscriptions.items()}
    name = next(n for n in (POSED_POSE.name, camera_topic(NAME, "mast", POSED_POSE)) if n in listens)
    listens[name](pose_to_msg(Pose.from_angles((0.0, 0.0, 90.0), 30.0), BEGIN_NS))
    for _ in range(round(max_wait / 0.5)):
        handler.tick(0.5)
    assert health.dropped == {}
    handler.tick(0.5)
    assert health.dropped == {"unjoined": 1}
    assert f"(waited {max_wait:g} s)" in health.last_error
    return {key: n for key, n in health.summary().items() if key.startswith("noted.unjoined.")}


def test_depth(small: SmallSite) -> None:
    health = Health()
    handler = DepthHandler(DepthConfig(site=str(small.path), camera="mast"), Kept(), health)
    assert given_up(handler, health, 60.0) == {"noted.unjoined.info": "1"}


def test_terrain_says_whose_frame(small: SmallSite) -> None:
    health = Health()
    handler = TerrainHandler(TerrainNodeConfig(site=str(small.path), depth_from_elsewhere=True), Kept(), health)
    lacked = ("depth", "sigma", "info")
    assert given_up(handler, health, 120.0) == {f"noted.unjoined.mast.{part}": "1" for part in lacked}
    assert "measured/sigma (sensor_msgs/msg/Image)" in health.last_error
