from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message

from ltm_core.base.resources import project_path
from ltm_core.site.site_io import load_site
from ltm_lab.bench.graph_site import SENT, Load, stamped, write_site
from ltm_msgs_py.image import compressed_size
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import describe

STAMP = 1_800_000_000_000_000_007


@pytest.mark.parametrize("fusion", [True, False])
def test_every_camera_has_frames_of_a_tower(tmp_path: Path, fusion: bool) -> None:
    traffic = write_site(tmp_path, project_path("bags/demo"), Load(3, fusion))
    site = load_site(traffic.site)
    assert tuple(site.cameras) == traffic.cameras
    assert site.open_dem().geometry.width > 100
    kinds = {node.name for node in describe(site, traffic.site)}
    assert ("topodepth" in kinds) == fusion
    places = set()
    for camera in traffic.cameras:
        for number in range(traffic.frames):
            parts = {
                part: deserialize_message(
                    stamped((tmp_path / camera / f"{number:03d}.{part}.cdr").read_bytes(), STAMP), topic.type
                )
                for part, topic in SENT.items()
            }
            assert {stamp_of(message) for message in parts.values()} == {STAMP}
            model = msg_to_camera(parts["info"])
            assert compressed_size(parts["image"]) == (model.width, model.height) == (1920, 1080)
        places.add((camera, *msg_to_pose(parts["pose"], "map").position))
    assert len({place[1:] for place in places}) == 2, "two towers, the third camera looks from the first"
