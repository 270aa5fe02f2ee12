"""From a video stream to a fuel map: what `ltm run` starts reads a real RTSP server, with a password."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from bystander import Bystander
from scenes.rtsp_camera import PASSWORD, SIZE, USER, RtspCamera, running
from scenes.small_site import NAME, Frame, SmallSite, like_its_paint
from scenes.waiting import wait_for

from ltm_core.geometry.camera import Camera
from ltm_core.site.site_io import load_site
from ltm_ros.launching.graph import describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, FUEL_VOTES, IMAGE_COMPRESSED, camera_topic, site_topic

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

HFOV = 62.0


@pytest.fixture
def camera(small: SmallSite, tmp_path: Path) -> Iterator[RtspCamera]:
    """Shows the painted ground from the mast's place; its clock is 37 s ahead."""
    pose = next(frame.pose for frame in small.frames(1) if frame.camera_name == "mast")
    photo = small.photo(Frame("mast", 0, Camera.from_fov(*SIZE, HFOV), pose))
    shown = tmp_path / "shown.i420"
    shown.write_bytes(np.asarray(cv2.cvtColor(photo, cv2.COLOR_RGB2YUV_I420)).tobytes())
    with running(RtspCamera(ahead=37.0, authentication="digest", shown=shown)) as camera:
        yield camera


def test_from_an_rtsp_stream_to_a_fuel_map(
    small: SmallSite, camera: RtspCamera, ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAST_PASSWORD", PASSWORD)
    content = yaml.safe_load(small.path.read_text())
    mast = content["cameras"]["mast"]
    del mast["image"]
    mast["calibration"] = {"width": SIZE[0], "height": SIZE[1], "hfov_deg": HFOV}
    mast["source"] = {
        "kind": "rtsp",
        "url": camera.url,
        "every": 0.4,
        "user": USER,
        "password": {"environment": "MAST_PASSWORD"},
    }
    content["cameras"] = {"mast": mast}
    small.path.write_text(yaml.safe_dump(content))
    site = load_site(small.path)
    lines: list[str] = []
    graph = describe(site, small.path, parameters={"fuel_map": {"export_path": str(tmp_path / "fuel_map.tif")}})
    runner = Runner(graph, domain_id=ros_domain, log_folder=tmp_path / "log", console=lines.append)
    began = time.time()
    update = site_topic(NAME, FUEL_MAP_UPDATE)
    images, votes = (camera_topic(NAME, "mast", topic) for topic in (IMAGE_COMPRESSED, FUEL_VOTES))
    with runner, Bystander() as bystander:
        bystander.listen(update, FUEL_MAP_UPDATE.type)
        bystander.listen(images, IMAGE_COMPRESSED.type)
        bystander.listen(votes, FUEL_VOTES.type)
        runner.wait_until_ready(120.0)
        bystander.wait_for_wiring(len(graph))
        wait_for(lambda: len(bystander.heard[update]) >= 4, "updates of the map", lambda: (bystander.summaries, lines))
        said = dict(bystander.summaries[f"/{NAME}/mast/source"])
        done, answer = bystander.call(f"/{NAME}/fuel_map/save")
        assert done, answer
    assert said["state"] == "alive", said
    assert all(began - 2.0 < stamp / 1e9 < time.time() for stamp in bystander.stamps(images))
    assert len(set(bystander.stamps(images)) & set(bystander.stamps(votes))) >= 3
    assert not any(PASSWORD in line for line in lines)
    seen, right = like_its_paint(tmp_path / "fuel_map.tif", site)
    assert seen > 20
    assert right > 0.7
