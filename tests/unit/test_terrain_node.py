"""The terrain node, fed with fused depth as a graph would: what it sends, keeps and refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import yaml
from outlets import Kept
from small_site import BEGIN_NS, MAST, NAME, SmallSite, write_small_site

from ltm_core.dem import Dem
from ltm_core.depth.fusion import Source
from ltm_core.errors import ConfigError, LtmError
from ltm_core.pose import Pose
from ltm_core.tracing import TerrainTracer
from ltm_msgs_py.camera_info import camera_to_msg
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.image import depth_to_msg, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.terrain import msg_to_changed
from ltm_ros.graph import describe
from ltm_ros.health import Health
from ltm_ros.nodes.terrain import Terrain, TerrainNodeConfig
from ltm_ros.topics import (
    FUSED_DEPTH,
    FUSED_SIGMA,
    FUSED_SOURCE,
    LABELS_IMAGE,
    POSED_CAMERA_INFO,
    POSED_POSE,
    TERRAIN_CHANGE,
    TERRAIN_INFO,
    TERRAIN_UPDATE,
    camera_topic,
)

HOUR = 3_600_000_000_000
SURE = np.diag([1e-4] * 3 + [1e-10] * 3)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    small = write_small_site(tmp_path_factory.mktemp("site"))
    content = yaml.safe_load(small.path.read_text())
    content["terrain"] = {"pixel_step": 1, "threshold": 2.0, "register_frames": False}
    small.path.write_text(yaml.safe_dump(content))
    return SmallSite(small.folder)


def node(small: SmallSite, **parameters: Any) -> tuple[Terrain, Kept, Health]:
    outlet, health = Kept(), Health()
    config = TerrainNodeConfig(site=str(small.path), depth_from_elsewhere=True, **parameters)
    terrain = Terrain(config, outlet, health)
    terrain.start()
    return terrain, outlet, health


def sunk(small: SmallSite) -> Dem:
    """Every second square of 12 x 12 cells is 9 m lower than the site's DEM says."""
    row, col = np.mgrid[0 : small.dem.geometry.height, 0 : small.dem.geometry.width]
    return Dem(small.dem.elevation - 9.0 * ((row // 12 + col // 12) % 2 == 0), small.dem.geometry)


def messages(small: SmallSite, surface: Dem, stamp: int, source: Source = Source.NETWORK) -> dict[Any, Any]:
    """What the mast's fusion would send of a surface."""
    pose = small.frames(1)[1].pose
    pose = Pose(pose.position + np.array([0.0, 0.0, 15.0]), pose.rotation)
    depth = TerrainTracer(surface).trace(MAST, pose).depth()
    ids = np.full(depth.shape, 3, np.uint8)
    frame = "mast_optical"
    return {
        LABELS_IMAGE: image_to_msg(ids, "mono8", stamp, frame),
        POSED_CAMERA_INFO: camera_to_msg(MAST, stamp, frame),
        POSED_POSE: pose_to_msg(pose, stamp, covariance=SURE),
        FUSED_SIGMA: depth_to_msg(np.full(depth.shape, 0.5, np.float32), stamp, frame),
        FUSED_SOURCE: image_to_msg(np.full(depth.shape, source, np.uint8), "mono8", stamp, frame),
        FUSED_DEPTH: depth_to_msg(depth, stamp, frame),
    }


def feed(terrain: Terrain, parts: dict[Any, Any]) -> None:
    listens = {topic.name: callback for topic, callback in terrain.subscriptions.items()}
    for topic, message in parts.items():
        listens[camera_topic(NAME, "mast", topic)](message)
    terrain.idle()


def test_change_goes_out_once_views_agree(small: SmallSite) -> None:
    terrain, outlet, health = node(small)
    truth = sunk(small)
    feed(terrain, messages(small, truth, BEGIN_NS))
    assert outlet.on(TERRAIN_UPDATE) == []
    feed(terrain, messages(small, truth, BEGIN_NS + 2 * HOUR))
    (update,) = outlet.on(TERRAIN_UPDATE)
    changed, z = msg_to_changed(update)
    was = small.dem.elevation[changed.rows, changed.cols]
    true = truth.elevation[changed.rows, changed.cols]
    assert len(z) > 50
    assert np.median(np.abs(z - true)) < 0.3 * np.median(np.abs(was - true))
    terrain.finish()
    kinds, geometry = msg_to_classes(outlet.on(TERRAIN_CHANGE)[-1])
    assert set(np.unique(kinds)) <= {0, 3, 255}
    assert int((kinds == 3).sum()) == len(z)
    assert geometry.resolution == 10.0
    info = json.loads(outlet.on(TERRAIN_INFO)[0].data)
    assert (info["kinds"]["grown"], info["resolution"], info["cameras"]) == (2, 10.0, ["mast", "tower"])
    assert health.dropped == {}


def test_what_was_traced_never_becomes_change(small: SmallSite) -> None:
    terrain, outlet, health = node(small)
    for hours in (0, 2):
        feed(terrain, messages(small, sunk(small), BEGIN_NS + hours * HOUR, Source.TERRAIN))
    assert outlet.on(TERRAIN_UPDATE) == []
    assert health.summary()["noted.nothing_seen"] == "2"


def test_the_surface_is_kept_and_written(small: SmallSite, tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    truth = sunk(small)
    terrain, _, _ = node(small, folder=str(folder))
    with pytest.raises(ConfigError, match="nothing to write"):
        terrain.save()
    feed(terrain, messages(small, truth, BEGIN_NS))
    terrain.finish()
    terrain, outlet, health = node(small, folder=str(folder))
    feed(terrain, messages(small, truth, BEGIN_NS))
    assert health.dropped == {"duplicate": 1}
    feed(terrain, messages(small, truth, BEGIN_NS + 2 * HOUR))
    assert len(outlet.on(TERRAIN_UPDATE)) == 1
    assert "terrain_height.tif" in terrain.save()
    terrain.finish()
    with rasterio.open(folder / "terrain_change.tif") as file:
        assert str(file.crs) == "EPSG:26911"
        assert json.loads(file.tags()["kinds"])["grown"] == 2
        assert (file.read(1) == 3).sum() > 50
    with rasterio.open(folder / "terrain_age.tif") as file:
        age = file.read(1)
        assert np.nanmin(age) == 0.0
        assert np.nanmax(age) <= 2.0
    with rasterio.open(folder / "terrain_since.tif") as file:
        assert json.loads(file.tags()["cameras"]) == ["mast", "tower"]
        assert set(np.unique(file.read(2))) == {0, 1}


def test_bad_frames_are_dropped_by_their_cause(small: SmallSite) -> None:
    terrain, outlet, health = node(small)

    def fails(kind: str, **parts: Any) -> None:
        message = messages(small, small.dem, BEGIN_NS + fails.number * HOUR)  # type: ignore[attr-defined]
        fails.number += 1  # type: ignore[attr-defined]
        given = {topic: parts.get(topic.name.replace("/", "_"), lambda m: m)(m) for topic, m in message.items()}
        with pytest.raises(LtmError) as caught:
            feed(terrain, given)
        assert type(caught.value).__name__ == kind, caught.value

    fails.number = 0  # type: ignore[attr-defined]

    def nan_pose(message: Any) -> Any:
        message.pose.pose.position.x = float("nan")
        return message

    def wild_covariance(message: Any) -> Any:
        message.pose.covariance[0] = float("nan")
        return message

    def small_image(message: Any) -> Any:
        return depth_to_msg(np.ones((5, 7), np.float32), BEGIN_NS + (fails.number - 1) * HOUR, "mast_optical")  # type: ignore[attr-defined]

    def underground(message: Any) -> Any:
        message.pose.pose.position.z -= 500.0
        return message

    fails("PoseError", posed_pose=nan_pose)
    fails("PoseError", posed_pose=wild_covariance)
    fails("ImageError", fused_sigma=small_image)
    fails("PoseError", posed_pose=underground)
    feed(terrain, messages(small, small.dem, BEGIN_NS + 40 * HOUR))
    assert outlet.on(TERRAIN_UPDATE) == []
    terrain.finish()
    assert health.dropped == {}


def test_a_site_without_measured_depth_is_refused(small: SmallSite) -> None:
    config = TerrainNodeConfig(site=str(small.path))
    with pytest.raises(ConfigError, match="traced depth agrees with the DEM by construction: give `depth_model`"):
        Terrain(config, Kept(), Health())


def test_the_graph_runs_it_where_the_site_asks_for_it(small: SmallSite) -> None:
    with_terrain = describe(small.site, small.path)
    assert with_terrain.node("terrain").full_name == f"/{NAME}/terrain"
    without = describe(small.site.model_copy(update={"terrain": None}), small.path)
    assert "terrain" not in [spec.label for spec in without]
    assert replace(with_terrain.node("terrain"), name="terrain").required
