import json
from typing import Any

import pytest

from ltm_core.base.resources import config_path, project_path
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.schemas import type_name_of
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
