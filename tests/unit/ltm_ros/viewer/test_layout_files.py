from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from ltm_core.base.resources import config_path, project_path
from ltm_core.geometry.grid import GridGeometry
from ltm_core.site.site_io import load_site
from ltm_core.surface.change import Changed
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.cells import changed_to_msg
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import Topic

SITE = load_site(project_path("bags/demo/site.yaml"))
FOXGLOVE: dict[str, Any] = json.loads(config_path("foxglove/ltm.json").read_text())


def known() -> dict[str, Topic]:
    """All topics of the demo's graph by absolute name."""
    own = [topic for topic in vars(topics).values() if isinstance(topic, Topic)]
    of_cameras = {topics.camera_topic(SITE.name, camera, topic): topic for camera in SITE.cameras for topic in own}
    return of_cameras | {topics.site_topic(SITE.name, topic): topic for topic in own}


KNOWN = known()


@pytest.mark.parametrize("panel", [panel for panel in FOXGLOVE["configById"] if panel.startswith("Image!")])
def test_images_of_foxglove_are_recorded_topics_of_their_type(panel: str) -> None:
    mode = FOXGLOVE["configById"][panel]["imageMode"]
    topic = KNOWN[mode["imageTopic"]]
    assert type_name_of(topic.type()) == mode["imageSchemaName"]
    assert topic in topics.RECORDED[0], "a recording shows it, too"
    assert KNOWN[mode["calibrationTopic"]] == topics.DEPTH_CAMERA_INFO


def test_the_scene_and_the_map_of_foxglove_show_topics_of_the_graph() -> None:
    scene, places = (FOXGLOVE["configById"][panel] for panel in ("3D!site", "map!site"))
    assert {KNOWN[name].type.__name__ for name in scene["topics"]} == {
        "OccupancyGrid",
        "PointCloud2",
        "PoseWithCovarianceStamped",
    }
    assert KNOWN[scene["publish"]["pointTopic"]] == topics.FUEL_MAP_QUERY
    for name in (places["followTopic"], *places["topicColors"]):
        assert type_name_of(KNOWN[name].type()) == "sensor_msgs/msg/NavSatFix"
    nothing = np.zeros(0, np.int32)
    changed = Changed(nothing, nothing, nothing.astype(np.uint8), nothing.astype(np.uint8), nothing.astype(np.float32))
    sent = changed_to_msg(changed, np.zeros(0, np.float32), GridGeometry(0.0, 60.0, 30.0, 3, 2), 0)
    shown = scene["topics"][topics.site_topic(SITE.name, topics.TERRAIN_UPDATE)]["colorField"]
    assert shown in [field.name for field in sent.fields]
