"""The page for interpreters, on the recording of the demonstration: answers, places and keys."""

import http.client
import json
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
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
from ltm_core.tracing import TerrainTracer
from ltm_ros.assessment.answers_io import Plan, SampledCell, read_answers, read_plan, write_table
from ltm_ros.assessment.cell_photos import PhotoIndex
from ltm_ros.assessment.look_session import LookServer, LookSession

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
    """A plan without the map: the page cannot show the map's answer."""
    folder = tmp_path / "plan"
    folder.mkdir()
    (folder / "plan.json").write_text(json.dumps({"version": 1, "crs": site.crs, "cell_m": 30.0, "site": "site.yaml"}))
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
    given = {"life_form": "shrub", "certainty": "likely", "seconds": 4.26}
    assert ask(server, "answer/3", "PUT", given)[0] == 200
    (stored,) = read_answers(plan.folder / "answers/first.csv")
    assert (stored.cell, stored.life_form, stored.certainty) == (plan.cells[3].cell, "shrub", "likely")
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


@pytest.mark.parametrize("path", ["answer/20", "answer/-1", "photo/0/3", "../cells.csv", "map.npz", "photo/0/..%2f0"])
def test_only_places_of_the_plan_have_an_address(server: LookServer, path: str) -> None:
    assert ask(server, path)[0] == 404
    assert ask(server, path, "PUT", {"life_form": "grass", "certainty": "sure", "seconds": 1})[0] == 404


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


def test_the_outline_contains_what_the_trace_finds_at_its_pixels(
    site: Site, photos: PhotoIndex, sampled: tuple[list[SampledCell], list[str]]
) -> None:
    """The ray through the middle of the outline meets the ground in the cell, or in front of its far part."""
    tracer = TerrainTracer(site.open_dem())
    for cell in sampled[0][:5]:
        for photo in photos.best(cell, 30.0):
            camera = photo.camera
            u, v = np.clip(photo.outline.mean(axis=0).round().astype(int), 0, (camera.width - 1, camera.height - 1))
            x, y, _ = tracer.trace(camera, photo.pose).points()[v, u]
            reach = 30.0 if photo.incidence_deg < 80 else 150.0
            assert abs(x + site.origin[0] - cell.x) < reach
            assert abs(y + site.origin[1] - cell.y) < reach


def test_photos_without_the_cell_are_not_shown(
    photos: PhotoIndex, sampled: tuple[list[SampledCell], list[str]]
) -> None:
    cell = sampled[0][0]
    assert len(photos.best(cell, 30.0)) in (1, 2, 3)
    assert photos.best(replace(cell, x=cell.x + 50_000), 30.0) == []


def test_photos_of_an_archive_are_those_of_its_recordings_at_any_depth_and_behind_links(
    site: Site, photos: PhotoIndex, sampled: tuple[list[SampledCell], list[str]], tmp_path: Path
) -> None:
    (tmp_path / "2037/06").mkdir(parents=True)
    (tmp_path / "2037/06/15").symlink_to(DEMO / "recording")
    found, expected = (index.best(sampled[0][0], 30.0) for index in (PhotoIndex(site, [tmp_path]), photos))
    assert {(p.camera_name, p.stamp_ns) for p in found} == {(p.camera_name, p.stamp_ns) for p in expected}
