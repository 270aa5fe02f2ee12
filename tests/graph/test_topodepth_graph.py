"""topodepth as a process on real DDS, with networks that answer nonsense: it names what is wrong, and depth flows."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from bystander import Bystander
from scenes.depth_scene import CAMERA, depth_scene
from scenes.networks import write_depth_network
from scenes.waiting import wait_for

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_msgs_py.image import depth_to_msg, image_to_msg, msg_to_depth
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    FUSED_DEPTH,
    FUSED_INFO,
    LABELS_IMAGE,
    POSED_CAMERA_INFO,
    POSED_IMAGE,
    POSED_POSE,
    camera_topic,
)

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

NAME = "hollow"
NETWORKS = {
    "constant": "same depth everywhere (0.5)",
    "nan": "no depth for 100% of its pixels",
    "negative": "the network's depth is opposite to the terrain's",
    "green": "the network's depth explains",
}
"""What the networks answer, each for a camera of its own, and words of what is said of them. The photos of the last two
are noise: numbers below 0, or above, that have nothing to do with the terrain, so that no samples agree on a scale."""
NOISE_SEEDS = {"negative": 3, "green": 5}
STAMP = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Living:
    bystander: Bystander

    def send(self, camera: str, stamp: int, traced: np.ndarray) -> None:
        scene = depth_scene()
        photo = scene.photo
        if camera in NOISE_SEEDS:
            photo = np.random.default_rng(NOISE_SEEDS[camera]).integers(0, 256, photo.shape).astype(np.uint8)
        frame = f"{camera}_optical"
        for topic, message in (
            (POSED_IMAGE, image_to_msg(photo, "rgb8", stamp, frame)),
            (POSED_CAMERA_INFO, camera_to_msg(CAMERA, stamp, frame)),
            (POSED_POSE, pose_to_msg(scene.traced.pose, stamp)),
            (LABELS_IMAGE, image_to_msg(scene.labels, "mono8", stamp, frame)),
            (DEPTH_IMAGE, depth_to_msg(traced, stamp, frame)),
        ):
            self.bystander.send(camera_topic(NAME, camera, topic), message)

    def fused(self, camera: str, stamp: int) -> np.ndarray:
        return msg_to_depth(self.bystander.wait_for_stamp(camera_topic(NAME, camera, FUSED_DEPTH), stamp))

    def info(self, camera: str, stamp: int) -> dict[str, object]:
        heard = self.bystander.heard[camera_topic(NAME, camera, FUSED_INFO)]
        wait_for(lambda: any(json.loads(m.data)["stamp_ns"] == stamp for m in heard), f"info of {camera}")
        return next(info for m in heard if (info := json.loads(m.data))["stamp_ns"] == stamp)


def write_site(folder: Path) -> Path:
    dem, place = depth_scene().dem, depth_scene().dem.geometry
    moved = GridGeometry(
        480_000.0 + place.x_min, 4_150_000.0 + place.y_max, place.resolution, place.width, place.height, "EPSG:26911"
    )
    Dem(dem.elevation, moved).save(folder / "dem.tif")
    for values in NETWORKS:
        (folder / values).mkdir()
        write_depth_network(folder / values, values=values)
    content = {
        "name": NAME,
        "crs": "EPSG:26911",
        "origin": [480_000.0, 4_150_000.0],
        "dem": {"path": "dem.tif"},
        "depth_model": "constant/depth.yaml",
        "cameras": {camera: {} for camera in NETWORKS},
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.fixture(scope="module")
def living(module_ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Living]:
    folder = tmp_path_factory.mktemp("hollow")
    site = write_site(folder)
    whole = describe(load_site(site), site)
    nodes = []
    for camera in NETWORKS:
        node = whole.node(f"{camera}/topodepth")
        nodes.append(replace(node, parameters={**node.parameters, "model": str(folder / camera / "depth.yaml")}))
    runner = Runner(
        Graph(NAME, tuple(nodes)), domain_id=module_ros_domain, log_folder=folder / "log", console=lambda line: None
    )
    with runner, Bystander() as bystander:
        runner.wait_until_ready(240.0)
        for camera in NETWORKS:
            for topic in (FUSED_DEPTH, FUSED_INFO):
                bystander.listen(camera_topic(NAME, camera, topic), topic.type, latched=topic is FUSED_INFO)
            for topic in (POSED_IMAGE, POSED_CAMERA_INFO, POSED_POSE, LABELS_IMAGE, DEPTH_IMAGE):
                bystander.open(camera_topic(NAME, camera, topic), topic.type)
        bystander.wait_for_wiring(len(NETWORKS))
        yield Living(bystander)
        assert all(process.starts == 1 for process in runner.processes.values()), "a node died and was started again"


@pytest.mark.parametrize(("camera", "reason"), NETWORKS.items())
def test_a_network_of_nonsense_is_named_and_the_terrain_flows(living: Living, camera: str, reason: str) -> None:
    traced = depth_scene().traced.depth()
    living.send(camera, STAMP, traced)
    depth = living.fused(camera, STAMP)
    unchanged = np.isfinite(traced) & ~depth_scene().stand
    assert (np.abs(depth[unchanged] - traced[unchanged]) < 0.03 * traced[unchanged]).mean() > 0.98
    info = living.info(camera, STAMP)
    assert info["verdict"] == "network_unusable"
    assert reason in str(info["reason"])
    said = living.bystander.summaries
    node = f"/{NAME}/{camera}/topodepth"
    wait_for(lambda: reason in said.get(node, {}).get("last_verdict", ""), f"diagnostics of {node}", lambda: said)


def test_an_empty_sky_and_a_dem_full_of_holes_are_named_and_flow(living: Living) -> None:
    traced = depth_scene().traced.depth()
    sky, holed = np.full_like(traced, np.inf), traced.copy()
    holed[::3] = holed[:, ::4] = np.nan
    living.send("nan", STAMP + 10, sky)
    assert np.isposinf(living.fused("nan", STAMP + 10)).all()
    assert living.info("nan", STAMP + 10)["verdict"] == "no_terrain"
    living.send("constant", STAMP + 20, holed)
    depth = living.fused("constant", STAMP + 20)
    known = np.isfinite(holed) & ~depth_scene().stand
    assert (np.abs(depth[known] - holed[known]) < 0.05 * holed[known]).mean() > 0.95
    unknown = np.isnan(holed)
    assert (~np.isfinite(depth[unknown])).mean() > 0.95, "what the DEM does not know is sky by its label, or unknown"
    assert living.info("constant", STAMP + 20)["verdict"] == "network_unusable"


def test_every_node_lives_on(living: Living) -> None:
    """After all the nonsense, each still answers; `living` sees that none had to be started again."""
    for camera in NETWORKS:
        living.send(camera, STAMP + 30, depth_scene().traced.depth())
        assert np.isfinite(living.fused(camera, STAMP + 30)).any()
