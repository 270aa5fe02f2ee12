from __future__ import annotations

import csv
import http.client
import json
import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.fuel.life_form import LifeForm
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.image_io import decode_rgb
from ltm_ros.assessment.answers_io import Plan, SampledCell, read_answers, read_plan, write_table
from ltm_ros.assessment.cell_photos import PhotoIndex
from ltm_ros.assessment.look_session import KEYS, LookServer, LookSession

DEMO = Path(__file__).parents[4] / "bags/demo"
CELLS = 20


@pytest.fixture(scope="module")
def site() -> Site:
    return load_site(DEMO / "site.yaml")


@pytest.fixture(scope="module")
def photos(site: Site) -> PhotoIndex:
    return PhotoIndex(site, [DEMO / "recording"])


@pytest.fixture(scope="module")
def sampled(site: Site, photos: PhotoIndex) -> tuple[list[SampledCell], list[str]]:
    """Cells with photos at random places, and the life form that truly covers each."""
    with rasterio.open(DEMO / "fuel_truth.tif") as source:
        truth, to_map = source.read(1), source.transform
    cells: list[SampledCell] = []
    for place in np.random.default_rng(5).permutation(truth.size):
        row, column = divmod(int(place), truth.shape[1])
        x, y = rasterio.transform.xy(to_map, row, column)
        lon, lat = site.frame.to_lonlat(x - site.origin[0], y - site.origin[1])
        cell = SampledCell(1000 + int(place), row, column, float(lon), float(lat), x, y)
        if 1 <= truth[row, column] <= len(LifeForm) and photos.best(cell, 30.0):
            cells.append(cell)
        if len(cells) == CELLS:
            break
    return cells, [LifeForm(int(truth[cell.row, cell.column])).name.lower() for cell in cells]


@pytest.fixture
def plan(tmp_path: Path, site: Site, sampled: tuple[list[SampledCell], list[str]]) -> Plan:
    folder = tmp_path / "plan"
    folder.mkdir()
    (folder / "plan.json").write_text(json.dumps({"version": 1, "crs": site.crs, "cell_m": 30.0}))
    write_table(folder / "cells.csv", list(vars(sampled[0][0])), map(vars, sampled[0]))
    return read_plan(folder)


@pytest.fixture
def server(plan: Plan, site: Site, photos: PhotoIndex) -> Iterator[LookServer]:
    with closing(LookServer(LookSession(plan, site, photos, "first"))) as served:
        yield served


def ask(server: LookServer, path: str, method: str = "GET", body: Any = None) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30)
    try:
        root = urlsplit(server.url).path
        connection.request(method, root + path, json.dumps(body), {"Content-Type": "application/json"})
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def test_an_answer_is_stored_at_once_and_the_next_session_resumes(
    server: LookServer, plan: Plan, site: Site, photos: PhotoIndex
) -> None:
    given = {"life_form": "shrub", "certainty": "likely", "before_life_form": "tree", "seconds": 4.26}
    assert ask(server, "answer/3", "PUT", given)[0] == 200
    (stored,) = read_answers(plan.folder / "answers/first.csv")
    assert (stored.cell, stored.life_form, stored.before_life_form) == (plan.cells[3].cell, "shrub", "tree")
    assert stored.seconds == 4.3
    again = LookSession(plan, site, photos, "first").overview()["answers"]
    assert [number for number, answer in enumerate(again) if answer] == [3]
    assert not any(LookSession(plan, site, photos, "second").overview()["answers"])


@pytest.mark.parametrize(
    "given",
    [
        {"life_form": "grass", "certainty": "cannot_be_seen", "seconds": 1},
        {"life_form": "", "certainty": "sure", "seconds": 1},
        {"life_form": "lava", "certainty": "sure", "seconds": 1},
        {"life_form": "grass", "certainty": "sure", "seconds": -1},
        {"life_form": "grass", "certainty": "sure", "seconds": 1, "cell": 7},
    ],
)
def test_an_invalid_answer_is_rejected_and_nothing_written(
    server: LookServer, plan: Plan, given: dict[str, Any]
) -> None:
    assert ask(server, "answer/0", "PUT", given)[0] == 400
    assert not (plan.folder / "answers").exists()


@pytest.mark.parametrize(
    "path", ["answer/20", "answer/-1", "photo/0/3", "../cells.csv", "strata.csv", "photo/0/..%2f0"]
)
def test_only_places_of_the_plan_have_an_address(server: LookServer, path: str) -> None:
    assert ask(server, path)[0] == 404
    assert ask(server, path, "PUT", {"life_form": "grass", "certainty": "sure", "seconds": 1})[0] == 404


def test_the_maps_answer_is_never_read(plan: Plan, server: LookServer) -> None:
    """The strata hold the map's classes: the page works without the file, and no response depends on it."""
    before = [ask(server, path) for path in ("", "cells", "cell/0")]
    with (plan.folder / "strata.csv").open("w") as file:
        csv.writer(file).writerows([["cell", "map_class"], *([cell.cell, "map_says"] for cell in plan.cells)])
    after = [ask(server, path) for path in ("", "cells", "cell/0")]
    assert before[1:] == after[1:]
    assert not any(b"map_says" in body for _, body in after)


@pytest.mark.parametrize("name", ["", "../x", "a/b", "a b", ".hidden", "x" * 41, "a\n", "é"])
def test_names_that_are_no_file_are_rejected(plan: Plan, site: Site, photos: PhotoIndex, name: str) -> None:
    with pytest.raises(ConfigError):
        LookSession(plan, site, photos, name)


def test_only_stated_hosts_of_tiles_may_be_contacted(plan: Plan, site: Site, photos: PhotoIndex) -> None:
    url = "https://tiles.example/{TileMatrix}/{TileRow}/{TileCol}.png"
    session = LookSession(plan, site, photos, "first", url)
    assert session.tiles == "https://tiles.example/{z}/{y}/{x}.png"
    for tiles, expected in ((url, "https://tiles.example"), ("", None)):
        with closing(LookServer(LookSession(plan, site, photos, "first", tiles))) as served:
            connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=30)
            connection.request("GET", urlsplit(served.url).path)
            policy = connection.getresponse().getheader("Content-Security-Policy", "")
            hosts = [part for part in policy.replace(";", " ").split() if part.startswith("http")]
            assert hosts == ([] if expected is None else [expected])
    for wrong in ("https://tiles.example/a.png", "https://a.example; script-src *//{z}{x}{y}", "/no/such.tif"):
        with pytest.raises(LtmError):
            LookSession(plan, site, photos, "first", wrong)


def test_an_orthophoto_lies_where_its_coordinates_say(
    tmp_path: Path, plan: Plan, site: Site, photos: PhotoIndex
) -> None:
    """An image that is bright east of the first cell's middle is bright in the right half of what the page shows."""
    cell, path = plan.cells[0], tmp_path / "orthophoto.tif"
    values = np.zeros((1, 100, 100), np.uint8)
    values[:, :, 50:] = 200
    corner = from_origin(cell.x - 500, cell.y + 500, 10, 10)
    with rasterio.open(
        path, "w", driver="GTiff", count=1, dtype="uint8", width=100, height=100, crs=site.crs, transform=corner
    ) as file:
        file.write(values)
    shown = decode_rgb(LookSession(plan, site, photos, "first", str(path)).imagery(0))
    middle = shown.shape[1] // 2
    assert shown[:, : middle - 20].max() < 20
    assert shown[:, middle + 20 :].min() > 180


@pytest.mark.slow
def test_twenty_cells_are_answered_in_a_real_browser(
    server: LookServer, plan: Plan, sampled: tuple[list[SampledCell], list[str]]
) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install 'ltm[dev]'")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs a Chromium (Debian: apt install chromium)")
    wrong: list[str] = []
    hosts: set[str] = set()
    letters = {name: key for key, name in KEYS.items()}
    truth = sampled[1]
    with playwright.sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.on("request", lambda request: hosts.add(urlsplit(request.url).netloc))
        page.goto(server.url)
        page.wait_for_selector("body[data-ready='0']")
        page.keyboard.press("1")  # no cover yet: nothing is stored
        assert not (plan.folder / "answers").exists()
        page.keyboard.press("n")
        page.wait_for_selector("body[data-ready='1']")
        page.keyboard.press("Backspace")
        page.wait_for_selector("body[data-ready='0']")
        for number, form in enumerate(truth):
            page.keyboard.press(letters[form])
            page.keyboard.press("1")
            state = "stored" if number + 1 == len(truth) else "ready"
            page.wait_for_selector(f"body[data-{state}='{min(number + 1, len(truth) - 1)}']")
        browser.close()
    assert not wrong
    assert hosts <= {urlsplit(server.url).netloc, ""}
    answers = {answer.cell: answer for answer in read_answers(plan.folder / "answers/first.csv")}
    assert [answers[cell.cell].life_form for cell in plan.cells] == truth
    seconds = sum(answer.seconds for answer in answers.values())  # the page's own part of an answer
    assert (5 + seconds / CELLS) * 300 <= 40 * 60
