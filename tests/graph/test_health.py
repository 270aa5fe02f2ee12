import http.client
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from bystander import Bystander
from scenes.free_port import free_port
from scenes.small_site import NAME, SmallSite
from scenes.waiting import wait_for
from tower_frames import TOPICS, send_frame

from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, camera_topic, site_topic

pytestmark = pytest.mark.graph
parser = pytest.importorskip("prometheus_client.parser", reason="the extra `tower` is not installed")

LTM = "from ltm_ros.cli.main import app; app()"


@dataclass
class Tower:
    site: SmallSite
    path: Path
    port: int
    process: subprocess.Popen[bytes]
    console: Path

    def get(self, path: str) -> tuple[int, str]:  # of a picture: its bytes, each as a character
        """(0, ...) while nobody answers."""
        try:
            with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)) as connection:
                connection.request("GET", path)
                answer = connection.getresponse()
                return answer.status, answer.read().decode("latin-1")
        except (OSError, http.client.HTTPException) as error:
            return 0, str(error)

    def said(self) -> str:
        return self.console.read_text()


@pytest.fixture(scope="module")
def tower(small_site: SmallSite, module_ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tower]:
    folder = tmp_path_factory.mktemp("health")
    port = free_port()
    path = small_site.folder / "watched.yaml"
    keys = yaml.safe_load(small_site.path.read_text())
    # A node that hangs is missed after 10 s, and shall be so until a person has asked, however long that takes: the
    # runner leaves it to the test.
    more = {"health": {"port": port}, "locating": {}}
    more["expert"] = {"health": {"frame_age": 3600.0}, "watchdog": {"silent": 3600.0}}
    path.write_text(yaml.safe_dump(keys | more))
    command = [sys.executable, "-c", LTM, "run", str(path), "--only", "tower", "--state", str(folder / "state")]
    with (folder / "console").open("w") as console:
        graph = subprocess.Popen(command, stdout=console, stderr=subprocess.STDOUT)
        try:
            yield Tower(small_site, path, port, graph, folder / "console")
            graph.send_signal(signal.SIGTERM)
            assert graph.wait(60) == 0
        finally:
            graph.kill()
            graph.wait()


def test_a_camera_that_sends_makes_a_tower_ready_and_numbers_are_those_of_the_diagnostics(tower: Tower) -> None:
    wait_for(lambda: tower.get("/healthz")[0] == 200, "all nodes", tower.said, patience_s=180.0)
    status, words = tower.get("/readyz")
    assert status == 503
    assert "tower: no frame since the start" in words

    update = site_topic(NAME, FUEL_MAP_UPDATE)
    with Bystander() as bystander:
        bystander.listen(update, FUEL_MAP_UPDATE.type, depth=200)
        for topic in TOPICS:
            bystander.open(camera_topic(NAME, "tower", topic), topic.type, listeners=1)
        bystander.wait_for_wiring(7)
        for _ in range(3):
            bystander.wait_for_stamp(update, send_frame(bystander, tower.site))
        wait_for(lambda: tower.get("/readyz")[0] == 200, "frames", lambda: tower.get("/readyz"))

        # Now nothing moves any more: both must come to say the same.
        def differences() -> list[str]:
            return [
                f"{name} {key}: {value} in /diagnostics, {numbers.get((name, key))} in /metrics"
                for numbers in (metrics(tower.get("/metrics")[1]),)
                for name, summary in dict(bystander.summaries).items()
                if not name.endswith("/health")
                for key, value in counts(summary).items()
                if numbers.get((name, key)) != value
            ]

        wait_for(lambda: bystander.count(f"/{NAME}/tower/capture", "frames_in") == 3, "capture's word")
        wait_for(lambda: not differences(), "the same numbers", differences)
        checked = sum(len(counts(summary)) for summary in dict(bystander.summaries).values())
    assert checked > 20

    def finished() -> int:
        """Of the frames, as the camera has last told: it hears of the last one's end after the map."""
        return int(json.loads(tower.get("/status.json")[1])["cameras"][0]["finished"])

    wait_for(lambda: finished() == 3, "the last frame's end", finished)
    said = json.loads(tower.get("/status.json")[1])
    (camera,) = said["cameras"]
    assert (camera["name"], camera["frames_in"], camera["finished"], camera["wrong"]) == ("tower", 3, 3, "")


def browse(tower: Tower, folder: Path, *options: str) -> str:
    """What a real browser makes of the page, after some seconds of its own time."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("needs a browser: apt install chromium")
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'browser'}"]
    command += ["--window-size=1280,1500", "--hide-scrollbars", "--virtual-time-budget=9000", *options]
    ran = subprocess.run(
        [*command, f"http://127.0.0.1:{tower.port}/"], capture_output=True, text=True, timeout=180, check=True
    )
    return ran.stdout


def test_the_page_shows_pictures_map_and_words(tower: Tower, tmp_path: Path) -> None:
    """In a real browser."""
    wait_for(lambda: tower.get("/readyz")[0] == 200, "frames", tower.said)
    assert tower.get("/picture/tower/secret.jpg")[0] == tower.get("/picture/mast/photo.jpg")[0] == 404
    wait_for(lambda: tower.get("/picture/tower/labels.jpg")[0] == 200, "a picture", tower.said)
    wait_for(lambda: tower.get("/map.png")[0] == 200, "the map", tower.said)
    page = browse(tower, tmp_path, "--dump-dom")
    assert re.search(r'<img alt="Last image of tower: photo" src="/picture/tower/photo\.jpg\?\d+', page), page
    assert "All nodes are healthy and all cameras are sending" in page
    assert re.search(r"Newest frame [\d.]+ (ms|s|min) ago .*3 frames received, 3 finished", page), page
    assert f"<td>/{NAME}/fuel_map</td>" in page
    shot = tmp_path / "page.png"
    browse(tower, tmp_path, f"--screenshot={shot}")
    colors = cv2.imread(str(shot)).reshape(-1, 3)
    assert len(colors) == 1280 * 1500
    # The site is painted in pure colours; its photo is on the page as it is.
    painted = (np.abs(colors.astype(int)[:, ::-1] - (0, 255, 0)).max(axis=1) < 30).mean()
    assert painted > 0.01, "the picture is drawn, not only named"


def test_a_click_in_a_picture_is_located(tower: Tower, tmp_path: Path) -> None:
    """In a real browser, by a real mouse: the tower's view straight ahead is ground."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install 'ltm[dev]'")
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("needs a browser: apt install chromium")
    wait_for(lambda: tower.get("/picture/tower/photo.jpg")[0] == 200, "a picture", tower.said, patience_s=180.0)
    with playwright.sync_playwright() as tools:
        page = tools.chromium.launch(executable_path=browser, args=["--no-sandbox"]).new_page()
        page.goto(f"http://127.0.0.1:{tower.port}/")
        page.wait_for_selector("img.markable[src^='/picture/tower/photo']")
        box = page.locator("img.markable").bounding_box()
        page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.8 * box["height"])
        page.wait_for_selector("#places tbody tr", timeout=60_000)
        assert "Marked: tower, pixel" in page.locator("#marked").inner_text()
        (place,) = json.loads(tower.get("/page.json")[1])["places"]
        told = page.locator("#places tbody tr").inner_text()
    assert place["sources"] == ["person"]
    assert place["seen_by"] == ["tower"]
    assert str(place["place"]["mgrs"]) in told


def counts(summary: dict[str, str]) -> dict[str, float]:
    """What of a summary counts something."""
    kinds = ("frames_in", "frames_out", "received", "published")
    return {k: float(v) for k, v in summary.items() if k in kinds or k.startswith(("dropped.", "noted."))}


def metrics(text: str) -> dict[tuple[str, str], float]:
    """Counters by node and the key that /diagnostics has for them."""
    found: dict[tuple[str, str], float] = {}
    for family in parser.text_string_to_metric_families(text):
        for sample in family.samples:
            labels: dict[str, Any] = sample.labels
            if "node" not in labels or not (matched := re.fullmatch(r"ltm_(\w+)_total", sample.name)):
                continue
            which = labels.get("cause") or labels.get("event")
            found[labels["node"], f"{matched[1]}.{which}" if which else matched[1]] = sample.value
    return found


def test_a_person_reads_the_same_and_learns_what_is_down(tower: Tower) -> None:
    wait_for(lambda: tower.get("/readyz")[0] == 200, "frames", tower.said)
    environment = os.environ | {"COLUMNS": "160"}
    command = [sys.executable, "-c", LTM, "status", str(tower.path)]
    ran = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert re.search(r"│ tower +│ alive +│ [\d :-]+│ +[\d.]+ s ago +│ +3 +│ +3 +│", ran.stdout), ran.stdout
    assert f"/{NAME}/fuel_map" in ran.stdout

    *_, last = (line for line in tower.said().splitlines() if "[fuel_map] -- started as process" in line)
    pid = int(last.rpartition(" ")[2])
    os.kill(pid, signal.SIGSTOP)
    wait_for(lambda: tower.get("/healthz")[0] == 503, "the node to be missed", lambda: tower.get("/healthz"))
    assert f"/{NAME}/fuel_map no report for" in tower.get("/healthz")[1]
    ran = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert ran.returncode == 1
    assert "silent" in ran.stdout
    os.kill(pid, signal.SIGKILL)
    # The runner starts another.
    wait_for(lambda: tower.get("/healthz")[0] == 200, "it to be back", lambda: tower.get("/healthz"), patience_s=120.0)


def test_nothing_listens_beyond_loopback(tower: Tower) -> None:
    wait_for(lambda: tower.get("/healthz")[0] == 200, "all nodes", tower.said, patience_s=180.0)
    lines = [
        line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]
    ]
    listening = [line[1] for line in lines if line[3] == "0A" and int(line[1].rpartition(":")[2], 16) == tower.port]
    assert listening == [f"0100007F:{tower.port:04X}"]
