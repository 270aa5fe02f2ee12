"""From a pan-tilt-zoom camera on a tour of its own to a fuel map: `ltm run` takes a picture where the head rests, and
knows from encoders, mount and zoom what each pixel saw."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bystander import Bystander
from scenes.http_camera import HttpCamera, running
from scenes.ptz_camera import FakeHead, Place, ptz_camera
from scenes.small_site import NAME, Frame, SmallSite, like_its_paint
from scenes.waiting import wait_for

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.zoom_lens import LensConfig, ZoomPoint
from ltm_core.pose_estimation.mount.mount_config import written_mount
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.site.site_io import load_site
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_ros.launching.graph import describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import CAMERA_INFO, FUEL_MAP_UPDATE, POSED_CAMERA_INFO, POSED_POSE, camera_topic, site_topic

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

PRESETS: dict[str, Place] = {"valley": (35.0, -13.0, 1.0), "ridge": (250.0, -11.0, 300.0)}
TABLE = (ZoomPoint(zoom=1, hfov_deg=62.0), ZoomPoint(zoom=9999, hfov_deg=2.5))
LENS = LensConfig(width=320, height=180, zoom=TABLE).lens()


@pytest.fixture
def model(small: SmallSite) -> MountModel:
    """A PTZ head that leans by more than a degree, and whose tilt axis is off."""
    x, y = 560.0, 470.0
    place = (x, y, float(small.dem.elevation_at(x, y)) + 45.0)
    sigmas = np.radians([0.05, 0.05, 0.05, 0.05])
    model = MountModel(Pose.from_angles(place, 20.0, 1.1, -0.7), math.radians(0.4), np.zeros((7, 7)))
    return model.with_angle_covariance(np.diag(sigmas**2))


@pytest.fixture
def head() -> FakeHead:
    return FakeHead(place=(120.0, 0.0, 1.0), rate=400.0)


@pytest.fixture
def camera(small: SmallSite, model: MountModel, head: FakeHead) -> Iterator[HttpCamera]:
    """Shows the painted ground at its presets; on its way between them, ground that is nowhere."""
    views = {}
    for pan, tilt, zoom in PRESETS.values():
        frame = Frame("tower", 0, LENS.camera(zoom), Pose(model.base.position, model.rotation(pan, tilt)))
        views[round(pan)] = small.photo(frame).astype(np.int16)

    def picture(place: Place) -> UInt8Array:
        rng = np.random.default_rng()
        at_rest = any(math.dist(place, preset) < 0.05 for preset in PRESETS.values())
        view = views[round(place[0])] if at_rest else np.full((180, 320, 3), (0, 255, 0), np.int16)
        return np.clip(view + rng.integers(-5, 6, view.shape), 0, 255).astype(np.uint8)

    ended = threading.Event()

    def tour() -> None:
        for place in itertools.cycle(PRESETS.values()):
            head.send(place)
            if ended.wait(3.0):
                return

    with running(ptz_camera(head, picture)) as camera:
        thread = threading.Thread(target=tour, daemon=True)
        thread.start()
        yield camera
        ended.set()
        thread.join()


def write_site(small: SmallSite, model: MountModel, camera: HttpCamera) -> None:
    site: dict[str, Any] = yaml.safe_load(small.path.read_text())
    site["cameras"] = {
        "tower": {
            "source": {"kind": "snapshot", "url": camera.url(), "every": 0.2},
            "ptz": {"kind": "vapix"},
            "mount": written_mount(model, LENS, small.site.frame),
        }
    }
    small.path.write_text(yaml.safe_dump(site, sort_keys=False))


def test_from_a_touring_head_to_a_fuel_map(
    small: SmallSite, model: MountModel, camera: HttpCamera, ros_domain: int, tmp_path: Path
) -> None:
    write_site(small, model, camera)
    site = load_site(small.path)
    lines: list[str] = []
    graph = describe(site, small.path, parameters={"fuel_map": {"export_path": str(tmp_path / "fuel_map.tif")}})
    runner = Runner(graph, domain_id=ros_domain, console=lines.append)
    update = site_topic(NAME, FUEL_MAP_UPDATE)
    poses, infos = camera_topic(NAME, "tower", POSED_POSE), camera_topic(NAME, "tower", POSED_CAMERA_INFO)
    with runner, Bystander() as bystander:
        bystander.listen(update, FUEL_MAP_UPDATE.type)
        bystander.listen(poses, POSED_POSE.type)
        bystander.listen(infos, CAMERA_INFO.type)

        def zoomed() -> set[float]:
            return {round(msg_to_camera(message).fx, 3) for message in bystander.heard[infos]}

        runner.wait_until_ready(120.0)
        wait_for(
            lambda: len(bystander.heard[update]) >= 6 and len(zoomed()) == 2,
            "updates of the map",
            lambda: (bystander.summaries, lines),
        )
        source = f"/{NAME}/tower/source"
        wait_for(lambda: source in bystander.summaries, "the source's own word", lambda: lines)
        said = dict(bystander.summaries[source])
        done, answer = bystander.call(f"/{NAME}/fuel_map/save")
        assert done, answer
    assert said["state"] == "alive", said
    assert int(said["dropped"]) == int(said.get("dropped.moved", 0)), said
    # Each pose is that of one of the presets, to what encoders tell; each focal length that of its zoom.
    expected = [model.pose(pan, tilt)[0] for pan, tilt, _ in PRESETS.values()]
    for message in bystander.heard[poses]:
        pose = msg_to_pose(message, "map")
        assert min(math.degrees(_turn(pose, other)) for other in expected) < 0.01
        assert 0.03 < math.degrees(math.sqrt(message.pose.covariance[35])) < 0.3
    assert zoomed() == {round(LENS.camera(zoom).fx, 3) for _, _, zoom in PRESETS.values()}
    seen, right = like_its_paint(tmp_path / "fuel_map.tif", site)
    assert seen > 20
    assert right > 0.7


def _turn(a: Pose, b: Pose) -> float:
    cosine = (np.trace(a.rotation.T @ b.rotation) - 1) / 2
    return math.acos(max(-1.0, min(1.0, float(cosine))))
