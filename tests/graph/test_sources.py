"""From a site file whose cameras have sources to a fuel map: what `ltm run` starts asks a real HTTP camera, with a
password and a clock that is wrong, while another camera is out of order."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
import yaml
from bystander import Bystander
from scenes.http_camera import Behaviour, HttpCamera, running
from scenes.small_site import NAME, SmallSite, like_its_paint
from scenes.timed_picture import jpeg
from scenes.waiting import wait_for

from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.launching.graph import describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    FUEL_MAP_UPDATE,
    FUEL_VOTES,
    IMAGE_COMPRESSED,
    POSE,
    POSED_POSE,
    camera_topic,
    site_topic,
)

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

PASSWORD = "tower-%7 secret"


@pytest.fixture
def camera(small: SmallSite) -> Iterator[HttpCamera]:
    """Shows the painted ground, with the noise of a sensor; its clock is an hour ahead."""
    photo = small.photo(next(frame for frame in small.frames(1) if frame.camera_name == "mast")).astype(np.int16)

    def render(moment: float) -> bytes:
        return jpeg(np.clip(photo + np.random.default_rng().integers(-5, 6, photo.shape), 0, 255).astype(np.uint8))

    with running(HttpCamera(Behaviour(authentication="digest", clock_ahead=3600.0, render=render))) as camera:
        yield camera


def write_sources(small: SmallSite, camera: HttpCamera) -> None:
    """The mast's camera is the one that runs; the tower's has the same place, and nothing at its port."""
    site = yaml.safe_load(small.path.read_text())
    mast = site["cameras"]["mast"]
    del mast["image"]
    source = {
        "kind": "snapshot",
        "url": camera.url(),
        "every": 0.5,
        "user": "viewer",
        "password": {"environment": "MAST_PASSWORD"},
    }
    site["cameras"] = {
        "mast": mast | {"source": source},
        "tower": mast | {"source": source | {"url": "http://127.0.0.1:1/snapshot.jpg"}},
    }
    small.path.write_text(yaml.safe_dump(site))


def test_from_a_snapshot_camera_to_a_fuel_map(
    small: SmallSite,
    camera: HttpCamera,
    ros_domain: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("MAST_PASSWORD", PASSWORD)
    write_sources(small, camera)
    site = load_site(small.path)
    lines: list[str] = []
    graph = describe(
        site,
        small.path,
        record={"bag": str(tmp_path / "bag")},
        parameters={"fuel_map": {"export_path": str(tmp_path / "fuel_map.tif")}},
    )
    runner = Runner(graph, domain_id=ros_domain, console=lines.append)
    began = time.time()
    update, image = site_topic(NAME, FUEL_MAP_UPDATE), camera_topic(NAME, "mast", IMAGE_COMPRESSED)
    with runner, Bystander() as bystander:
        bystander.listen(update, FUEL_MAP_UPDATE.type)
        for topic in (IMAGE_COMPRESSED, CAMERA_INFO, POSE, POSED_POSE, FUEL_VOTES):
            bystander.listen(camera_topic(NAME, "mast", topic), topic.type)
        runner.wait_until_ready(120.0)
        bystander.wait_for_wiring(len(graph))
        wait_for(lambda: len(bystander.heard[update]) >= 5, "updates of the map", lambda: (bystander.summaries, lines))
        well, broken = f"/{NAME}/mast/source", f"/{NAME}/tower/source"
        wait_for(lambda: bystander.summaries.get(broken, {}).get("state") == "stalled", "the broken one's state")
        summaries = dict(bystander.summaries)
        done, answer = bystander.call(f"/{NAME}/fuel_map/save")
        assert done, answer
    said = summaries[well]
    assert (said["state"], said["dropped"], said["stamp_told_by"]) == ("alive", "0", "last-modified"), said
    assert float(said["camera_clock_ahead_s"]) == pytest.approx(3600.0, abs=1.0)
    assert said["camera_clock_resets"] == "0"
    assert "no connection" in summaries[broken]["state_why"]
    stamps = bystander.stamps(image)
    assert stamps == sorted(set(stamps))
    assert all(began - 2.0 < stamp / 1e9 < time.time() for stamp in stamps)
    # One stamp for all that belongs to a picture, up to its votes.
    for topic in (CAMERA_INFO, POSE, POSED_POSE, FUEL_VOTES):
        assert len(set(bystander.stamps(camera_topic(NAME, "mast", topic))) & set(stamps)) >= 3, topic
    seen, right = like_its_paint(tmp_path / "fuel_map.tif", site)
    assert seen > 20
    assert right > 0.7
    # Nothing that was logged, told or recorded holds the password.
    recorded = b"".join(message.raw for message in BagReader(tmp_path / "bag").messages())
    assert camera_topic(NAME, "mast", IMAGE_COMPRESSED) in BagReader(tmp_path / "bag").topics()
    logged = "\n".join([*lines, str(summaries)])
    for spelling in (PASSWORD, quote(PASSWORD), quote(PASSWORD, safe="")):
        assert spelling not in logged
        assert spelling.encode() not in recorded
    assert "Traceback" not in logged
