"""viewer: what it asks the graph for, and what it shows of fused depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from outlets import Kept
from small_site import write_small_site

from ltm_msgs_py.image import depth_to_msg
from ltm_ros.health import Health
from ltm_ros.topics import DEPTH_IMAGE, FUSED_DEPTH, NETWORK_DEPTH, camera_topic

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from rerun.chunk import RrdReader

from ltm_ros.nodes.viewer import Viewer, ViewerConfig

STAMP = 1_700_000_000_000_000_000


def viewer(path: Path, save: Path) -> Viewer:
    return Viewer(ViewerConfig(site=str(path), save=str(save)), Kept(), Health())


def test_fused_depth_is_shown_beside_traced_and_the_networks_of_the_same_stamp(tmp_path: Path) -> None:
    small = write_small_site(tmp_path)
    path = small.path
    path.write_text(path.read_text() + yaml.safe_dump({"depth_model": "depth.yaml"}))
    camera = next(iter(small.site.cameras))
    node = viewer(path, tmp_path / "view.rrd")
    take = {topic.name: callback for topic, callback in node.subscriptions.items()}
    depth = np.full((36, 64), 800.0, np.float32)

    def send(topic: object, stamp: int, size: tuple[int, int] = (36, 64)) -> None:
        take[camera_topic(small.site.name, camera, topic)](depth_to_msg(depth[: size[0], : size[1]], stamp, "c"))

    send(NETWORK_DEPTH, STAMP, (18, 32))
    send(FUSED_DEPTH, STAMP)
    send(DEPTH_IMAGE, STAMP)
    send(DEPTH_IMAGE, STAMP + 5)
    send(FUSED_DEPTH, STAMP + 5)
    node.finish()
    shown: dict[str, int] = {}
    for chunk in RrdReader(str(tmp_path / "view.rrd")).stream():
        entity = str(chunk.entity_path)
        shown[entity] = shown.get(entity, 0) + chunk.to_record_batch().num_rows
    assert shown[f"/fusion/{camera}/fused"] == 2
    assert shown[f"/fusion/{camera}/difference"] == 2
    assert shown[f"/fusion/{camera}/network"] == 1, "the second frame's network depth never came"


def test_without_a_depth_network_nobody_is_asked_for_fused_depth(tmp_path: Path) -> None:
    node = viewer(write_small_site(tmp_path).path, tmp_path / "view.rrd")
    assert not [topic.name for topic in node.subscriptions if "fused" in topic.name or "network" in topic.name]
    node.finish()
