"""The lines of the page on sites for an IP camera, as they stand there: from a camera's bare address to a fuel map."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from bystander import Bystander
from pyproj import Transformer
from scenes.http_camera import Behaviour, HttpCamera, running
from scenes.small_site import NAME, Frame, SmallSite, paint_at, write_small_site
from scenes.timed_picture import jpeg
from scenes.waiting import wait_for

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pipeline.stored_fuel import STORE_FILE
from ltm_msgs_py.grid import msg_to_classes
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, site_topic

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

PAGE = Path(__file__).parents[2] / "docs/site.md"
LTM = [sys.executable, "-c", "from ltm_ros.cli.main import app; app()"]
PASSWORD = "tower-%7 secret"
PLACE = (900.0, 700.0)
"""Map frame; from here the ground falls away to the south-west, whither the README's camera looks."""


def page_lines() -> list[list[str]]:
    """The words of each line of the block that begins with a camera's password, without its comment."""
    (block,) = [b for b in PAGE.read_text(encoding="utf-8").split("```") if "ltm cameras probe" in b]
    return [shlex.split(line, comments=True) for line in block.splitlines()[1:] if line.strip()]


def option(words: list[str], name: str) -> str:
    return words[words.index(name) + 1]


@pytest.fixture
def small(tmp_path: Path) -> SmallSite:
    """With one camera, of which nobody says anything: a site has at least one."""
    small = write_small_site(tmp_path, recording=False)
    site = yaml.safe_load(small.path.read_text())
    site["cameras"] = {"tower": {}}
    small.path.write_text(yaml.safe_dump(site, sort_keys=False))
    return small


def view(small: SmallSite, probe: list[str]) -> UInt8Array:
    """What a camera sees that stands as the page's line says, but for its place."""
    x, y = PLACE
    z = float(small.dem.elevation_at(x, y)) + float(option(probe, "--height"))
    pose = Pose.from_angles((x, y, z), float(option(probe, "--azimuth")), 0.0, 0.0)
    return small.photo(Frame("north", 0, Camera.from_fov(320, 180, float(option(probe, "--hfov"))), pose))


@pytest.fixture
def camera() -> Iterator[HttpCamera]:
    with running(HttpCamera(Behaviour(authentication="digest", password=PASSWORD))) as camera:
        yield camera


def test_the_lines_lead_to_a_fuel_map(small: SmallSite, camera: HttpCamera, ros_domain: int, tmp_path: Path) -> None:
    (_, password), probe, check, run, *_ = page_lines()
    photo = view(small, probe).astype(np.int16)
    camera.behaviour.user = option(probe, "--user")
    camera.behaviour.render = lambda moment: jpeg(
        np.clip(photo + np.random.default_rng().integers(-5, 6, photo.shape), 0, 255).astype(np.uint8)
    )
    environment = os.environ | {password.partition("=")[0]: PASSWORD, "COLUMNS": "200"}
    # The address of the camera and its place are ours, all else is the page's.
    x0, y0 = small.site.origin
    to_degrees = Transformer.from_crs(small.site.crs, "EPSG:4326", always_xy=True)
    lon, lat = to_degrees.transform(PLACE[0] + x0, PLACE[1] + y0)
    probe[probe.index("probe") + 1] = camera.url("")
    probe[probe.index("--lonlat") + 1] = f"{lon:.8f},{lat:.8f}"
    for words in (probe, check):
        done = subprocess.run(
            [*LTM, *words[1:]], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert PASSWORD not in done.stdout + done.stderr
    update = site_topic(NAME, FUEL_MAP_UPDATE)
    console = tmp_path / "console"
    with console.open("w") as said:
        graph = subprocess.Popen([*LTM, *run[1:]], cwd=tmp_path, env=environment, stdout=said, stderr=subprocess.STDOUT)
        try:
            # It goes first: what it maps of a node that had to be ended (`dds_shutdown`), no runner can remove.
            with Bystander() as bystander:
                bystander.listen(update, FUEL_MAP_UPDATE.type)
                wait_for(
                    lambda: bystander.heard[update],
                    "an update of the map",
                    lambda: (bystander.summaries, console.read_text()),
                    patience_s=180.0,
                )
            graph.send_signal(signal.SIGTERM)
            assert graph.wait(60) == 0
        finally:
            graph.kill()
            graph.wait()
    assert PASSWORD not in console.read_text()
    assert (tmp_path / option(run, "--state") / STORE_FILE).is_file()
    classes, geometry = msg_to_classes(bystander.heard[update][-1])
    truth = paint_at(*geometry.to_map(*np.mgrid[: geometry.height, : geometry.width]))
    seen = classes != 255
    assert seen.sum() > 10
    assert (classes == truth)[seen].mean() > 0.7
