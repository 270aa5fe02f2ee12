from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.outlets import Kept
from scenes.small_site import write_small_site

from ltm_core.base.errors import MessageError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.change import Changed, ChangeKind
from ltm_msgs_py.cells import changed_to_msg
from ltm_msgs_py.grid import classes_to_msg
from ltm_msgs_py.image import depth_to_msg
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    FUSED_DEPTH,
    NETWORK_DEPTH,
    TERRAIN_CHANGE,
    TERRAIN_UPDATE,
    camera_topic,
    site_topic,
)

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from rerun.chunk import RrdReader

from ltm_ros.nodes.viewer import ViewerConfig, ViewerHandler

STAMP = 1_700_000_000_000_000_000


def viewer(path: Path, save: Path) -> ViewerHandler:
    return ViewerHandler(ViewerConfig(site=str(path), save=str(save)), Kept(), Health())


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


def test_changes_of_the_surface_lie_where_they_are_on_the_fuel_grid(tmp_path: Path) -> None:
    small = write_small_site(tmp_path)
    path = small.path
    path.write_text(path.read_text() + yaml.safe_dump({"depth_model": "depth.yaml", "terrain": {}}))
    node = viewer(path, tmp_path / "view.rrd")
    take = {topic.name: callback for topic, callback in node.subscriptions.items()}
    under = small.site.fuel_geometry(small.dem)
    window = GridGeometry(under.x_min + 90.0, under.y_max - 60.0, 10.0, 7, 4)
    kinds = np.full(window.shape, 255, np.uint8)
    kinds[2, 3] = ChangeKind.GROWN
    take[site_topic(small.site.name, TERRAIN_CHANGE)](classes_to_msg(kinds, window, STAMP))
    one = np.array([1])
    changed = Changed(one, one, 0 * one.astype(np.uint8), one.astype(np.uint8), np.array([-4.0], np.float32))
    take[site_topic(small.site.name, TERRAIN_UPDATE)](changed_to_msg(changed, np.array([300.0]), window, STAMP))
    node.finish()
    found: dict[str, list[dict[str, Any]]] = {}
    for chunk in RrdReader(str(tmp_path / "view.rrd")).stream():
        batch = chunk.to_record_batch()
        parts = {name: batch.column(name).to_pylist() for name in batch.schema.names if ":" in name}
        found.setdefault(str(chunk.entity_path), []).append(parts)
    (picture,) = found["/terrain/change"]
    assert picture["Transform3D:translation"][0][0] == pytest.approx([90 / under.resolution, 60 / under.resolution, 0])
    assert picture["Transform3D:scale"][0][0] == pytest.approx([10 / under.resolution, 10 / under.resolution, 1])
    assert "grown" in str(found["/terrain"])
    (points,) = found["/map/change"]
    x, y = window.to_map(1, 1)
    assert points["Points3D:positions"][0][0] == pytest.approx([float(x), float(y), 300.0])


def test_kinds_of_change_that_there_are_not_end_no_viewer(tmp_path: Path) -> None:
    small = write_small_site(tmp_path)
    path = small.path
    path.write_text(path.read_text() + yaml.safe_dump({"depth_model": "depth.yaml", "terrain": {}}))
    node = viewer(path, tmp_path / "view.rrd")
    take = {topic.name: callback for topic, callback in node.subscriptions.items()}
    one = np.array([1])
    changed = Changed(one, one, 0 * one.astype(np.uint8), np.array([97], np.uint8), np.array([-4.0], np.float32))
    message = changed_to_msg(changed, np.array([300.0]), GridGeometry(0.0, 40.0, 10.0, 7, 4), STAMP)
    with pytest.raises(MessageError, match="change is 97; valid kinds are 0 to 3"):
        take[site_topic(small.site.name, TERRAIN_UPDATE)](message)
    node.finish()
