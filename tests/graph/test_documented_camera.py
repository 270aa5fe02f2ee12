import json
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
import yaml
from bystander import Bystander
from pyproj import Transformer
from scenes.free_port import free_port
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

PAGE = Path(__file__).parents[2] / "docs/cameras.md"
LTM = [sys.executable, "-c", "from ltm_ros.cli.main import app; app()"]
PASSWORD = "tower-%7 secret"
PLACE = (900.0, 700.0)
"""Map frame; from here the ground falls away to the south-west, whither the guide's camera looks."""


def guide() -> tuple[list[list[str]], dict[str, Any]]:
    """Return the words of each command of the guide, and the lines that it adds to the site file."""
    text = PAGE.read_text(encoding="utf-8").partition("## Guide: a tower with IP cameras")[2].partition("\n## ")[0]
    assert len(text.split()) <= 600
    blocks = re.findall(r"```(\w+)\n(.*?)```", text, re.DOTALL)
    commands = [
        words
        for kind, block in blocks
        for line in block.splitlines()
        if kind == "sh" and (words := shlex.split(line, comments=True))
    ]
    (added,) = [yaml.safe_load(block) for kind, block in blocks if kind == "yaml"]
    return commands, added


def option(words: list[str], name: str) -> str:
    return words[words.index(name) + 1]


@contextmanager
def receiver() -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Yield the port of a webhook and the messages that it has received."""
    messages: list[dict[str, Any]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            messages.append(json.loads(self.rfile.read(int(self.headers["content-length"]))))
            self.send_response(204)
            self.end_headers()

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port, messages
        server.shutdown()


def view(small: SmallSite, probe: list[str]) -> UInt8Array:
    """What a camera sees that stands as the guide says, but for its place."""
    x, y = PLACE
    z = float(small.dem.elevation_at(x, y)) + float(option(probe, "--height"))
    pose = Pose.from_angles((x, y, z), float(option(probe, "--azimuth")), 0.0, 0.0)
    return small.photo(Frame("north", 0, Camera.from_fov(320, 180, float(option(probe, "--hfov"))), pose))


@pytest.fixture
def camera() -> Iterator[HttpCamera]:
    with running(HttpCamera(Behaviour(authentication="digest", password=PASSWORD))) as camera:
        yield camera


def test_the_guide_leads_to_a_running_tower(camera: HttpCamera, ros_domain: int, tmp_path: Path) -> None:
    (password, query, add, check, run, status), added = guide()
    assert [words[:2] for words in (query, add, check, run)] == [
        ["ltm", "cameras"], ["ltm", "cameras"], ["ltm", "check"], ["ltm", "run"]
    ]  # fmt: skip
    small = write_small_site(tmp_path, recording=False)
    photo, (x0, y0), crs = view(small, add).astype(np.int16), small.site.origin, small.site.crs
    content = yaml.safe_load(small.path.read_text())
    del content["cameras"]
    small.path.write_text(yaml.safe_dump(content, sort_keys=False))
    camera.behaviour.user = option(add, "--user")
    camera.behaviour.render = lambda moment: jpeg(
        np.clip(photo + np.random.default_rng().integers(-5, 6, photo.shape), 0, 255).astype(np.uint8)
    )
    environment = os.environ | {password[1].partition("=")[0]: PASSWORD, "COLUMNS": "200"}
    # The addresses and the place of the camera are ours, all else is the guide's.
    lon, lat = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(PLACE[0] + x0, PLACE[1] + y0)
    add[add.index("--lonlat") + 1] = f"{lon:.8f},{lat:.8f}"
    for words in (query, add):
        words[words.index("probe") + 1] = camera.url("")

    def ran(words: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*LTM, *words[1:]], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )

    def does(words: list[str]) -> str:
        done = ran(words)
        assert done.returncode == 0, done.stdout + done.stderr
        assert PASSWORD not in done.stdout + done.stderr
        return done.stdout

    said = does(query)
    assert "320 x 180 pixels" in said
    assert "still to be added" in said
    assert "wrote camera north into site.yaml" in does(add)
    update = site_topic(NAME, FUEL_MAP_UPDATE)
    console = tmp_path / "console"
    with receiver() as (port, messages), console.open("w") as printed:
        added["health"]["port"] = free_port()
        added["alerts"]["webhook"] = f"http://127.0.0.1:{port}/ltm"
        small.path.write_text(f"{small.path.read_text()}\n{yaml.safe_dump(added)}")
        assert re.search(r"\b(no|0) errors", does(check))
        assert (tmp_path / option(check, "--out")).is_file()
        graph = subprocess.Popen(
            [*LTM, *run[1:]], cwd=tmp_path, env=environment, stdout=printed, stderr=subprocess.STDOUT
        )
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
            wait_for(lambda: messages, "a message", lambda: console.read_text())
            # On a busy machine the map's first update can come before its node's first report.
            wait_for(lambda: ran(status).returncode == 0, "a report of each node", lambda: ran(status).stdout)
            assert re.search(r"north .*alive", does(status))
            graph.send_signal(signal.SIGTERM)
            assert graph.wait(60) == 0
        finally:
            graph.kill()
            graph.wait()
    assert (messages[0]["site"], messages[0]["state"]) == (NAME, "started")
    assert f"http://127.0.0.1:{added['health']['port']}" in console.read_text()
    assert PASSWORD not in console.read_text()
    assert (tmp_path / option(run, "--state") / STORE_FILE).is_file()
    classes, geometry = msg_to_classes(bystander.heard[update][-1])
    truth = paint_at(*geometry.to_map(*np.mgrid[: geometry.height, : geometry.width]))
    seen = classes != 255
    assert seen.sum() > 10
    assert (classes == truth)[seen].mean() > 0.7
