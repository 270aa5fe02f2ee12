from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.depth_scene import CAMERA, DepthScene, depth_scene
from scenes.networks import write_depth_network
from scenes.outlets import Kept

from ltm_core.depth.monocular import DepthNetwork
from ltm_core.depth.topodepth import DepthSource
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_msgs_py.image import depth_to_msg, image_to_msg, msg_to_array, msg_to_depth
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.status import msg_to_values
from ltm_ros.nodes.topodepth import TopoDepthConfig, TopoDepthHandler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    FUSED_DEPTH,
    FUSED_INFO,
    FUSED_SIGMA,
    FUSED_SOURCE,
    LABELS_IMAGE,
    MEASURED_DEPTH,
    MEASURED_SIGMA,
    NETWORK_DEPTH,
    POSED_CAMERA_INFO,
    POSED_IMAGE,
    POSED_POSE,
)

STAMP = 1_700_000_000_000_000_000


def site_file(folder: Path, **changes: Any) -> Path:
    rough = depth_scene().dem
    geometry = rough.geometry
    moved = GridGeometry(
        480_000.0 + geometry.x_min,
        4_150_000.0 + geometry.y_max,
        geometry.resolution,
        geometry.width,
        geometry.height,
        "EPSG:26911",
    )
    Dem(rough.elevation, moved).save(folder / "dem.tif")
    content = {
        "name": "hollow",
        "crs": "EPSG:26911",
        "origin": [480_000.0, 4_150_000.0],
        "dem": {"path": "dem.tif"},
        "depth_model": "depth.yaml",
        "cameras": {"mast": {}},
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content | changes))
    return path


class Node:
    """The handler with what it sent; `feed` gives it a frame, `network` replaces what its network answers."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, network: Any = None, **config: Any) -> None:
        write_depth_network(folder)
        path = site_file(folder)
        self.kept, self.health = Kept(NETWORK_DEPTH), Health()
        self.handler = TopoDepthHandler(
            TopoDepthConfig(site=str(path), camera="mast", **config), self.kept, self.health
        )
        answer = depth_scene().network() if network is None else network
        monkeypatch.setattr(DepthNetwork, "predict", lambda self, rgb, camera: answer)

    def feed(self, *parts: str, stamp: int = STAMP, scene: DepthScene | None = None, pitch: float = 0.0) -> None:
        scene = depth_scene() if scene is None else scene
        traced = scene.traced if pitch == 0.0 else scene.turned(pitch)
        messages = {
            "image": (POSED_IMAGE, image_to_msg(scene.photo, "rgb8", stamp, "mast_optical")),
            "info": (POSED_CAMERA_INFO, camera_to_msg(CAMERA, stamp, "mast_optical")),
            "pose": (POSED_POSE, pose_to_msg(traced.pose, stamp)),
            "depth": (DEPTH_IMAGE, depth_to_msg(traced.depth(), stamp, "mast_optical")),
            "labels": (LABELS_IMAGE, image_to_msg(scene.labels, "mono8", stamp, "mast_optical")),
        }
        for part in parts or messages:
            topic, message = messages[part]
            self.handler.subscriptions[topic](message)

    @property
    def infos(self) -> list[dict[str, Any]]:
        return [{"stamp_ns": stamp_of(m), **msg_to_values(m)} for m in self.kept.on(FUSED_INFO)]


@pytest.mark.parametrize(
    "order", [("image", "info", "pose", "depth", "labels"), ("labels", "depth", "pose", "info", "image")]
)
def test_a_frame_comes_out_fused_with_its_stamp(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, order: tuple[str, ...]
) -> None:
    node = Node(tmp_path, monkeypatch)
    node.feed(*order)
    for topic in (FUSED_DEPTH, FUSED_SIGMA, FUSED_SOURCE, MEASURED_DEPTH, MEASURED_SIGMA, NETWORK_DEPTH):
        assert node.kept.stamps(topic) == [STAMP]
    depth = msg_to_depth(node.kept.on(FUSED_DEPTH)[0])
    source = msg_to_array(node.kept.on(FUSED_SOURCE)[0], ("mono8",))
    scene = depth_scene()
    traced = scene.traced.depth()
    stand = scene.stand
    assert np.abs(depth[stand] - scene.truth[stand]).mean() < 0.4 * np.abs(traced[stand] - scene.truth[stand]).mean()
    assert (source[~np.isfinite(scene.truth)] == DepthSource.SKY).mean() > 0.98
    measured, sigma = (msg_to_depth(node.kept.on(topic)[0]) for topic in (MEASURED_DEPTH, MEASURED_SIGMA))
    np.testing.assert_array_equal(np.isfinite(measured), sigma > 0)
    assert np.isfinite(measured[stand[2::4, 2::4]]).mean() > 0.5
    (info,) = node.infos
    assert (info["verdict"], info["stamp_ns"]) == ("ok", STAMP)
    assert float(info["inlier_ratio"]) > 0.5
    assert node.health.summary()["verdict"] == "ok"


def test_no_more_frames_wait_than_allowed_and_none_is_lost_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = Node(tmp_path, monkeypatch, max_waiting=1)
    for i in range(2):
        node.feed("image", "info", "pose", "depth", stamp=STAMP + i)
    assert node.kept.stamps(FUSED_DEPTH) == [STAMP]
    node.handler.finish()
    assert node.kept.stamps(FUSED_DEPTH) == [STAMP, STAMP + 1]


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (lambda: np.full((9, 16), 0.4, np.float32), "same depth everywhere (0.4)"),
        (lambda: np.full((9, 16), np.nan, np.float32), "no depth for 100% of its pixels"),
        (lambda: -depth_scene().network().values, "is opposite to the terrain"),
        (lambda: np.random.default_rng(0).random((90, 160), np.float32), "explains only"),
    ],
)
def test_a_broken_network_is_named_and_the_terrain_flows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, values: Callable[[], Any], reason: str
) -> None:
    from ltm_core.depth.monocular import NetworkDepth

    node = Node(tmp_path, monkeypatch, NetworkDepth(values(), "relative_inverse"))
    node.feed()
    assert node.infos[0]["verdict"] == "network_unusable"
    assert reason in node.infos[0]["reason"]
    assert reason in node.health.summary()["last_verdict"]
    assert node.kept.on(NETWORK_DEPTH) == []
    assert np.isnan(msg_to_depth(node.kept.on(MEASURED_DEPTH)[0])).all()
    depth, traced = msg_to_depth(node.kept.on(FUSED_DEPTH)[0]), depth_scene().traced.depth()
    unchanged = np.isfinite(traced) & ~depth_scene().stand
    assert (np.abs(depth[unchanged] - traced[unchanged]) < 0.03 * traced[unchanged]).mean() > 0.98


def test_a_wrong_pose_is_marked_and_nothing_is_fused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node(tmp_path, monkeypatch)
    node.feed(pitch=0.8)
    assert node.infos[0]["verdict"] == "pose_suspected"
    assert node.health.summary()["noted.verdict.pose_suspected"] == "1"
    assert float(node.infos[0]["pose.pitch_deg"]) == pytest.approx(-0.8, abs=0.15)
    np.testing.assert_array_equal(msg_to_depth(node.kept.on(FUSED_DEPTH)[0]), depth_scene().turned(0.8).depth())
