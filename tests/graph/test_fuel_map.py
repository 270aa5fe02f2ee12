"""The fuel map as a process on real DDS: killed under load it keeps what it told of; cameras join, people ask."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bystander import Bystander
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped
from scenes.fuel_frames import CAMERAS, NAME, camera_of, grid_of, message, stamp_of_frame, write_site
from scenes.waiting import wait_for

from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.rules import FusionRules, reach_of
from ltm_core.pipeline.site_surface import terrain_grid
from ltm_core.pipeline.stored_fuel import STORE_FILE
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.change import Changed, ChangeKind
from ltm_msgs_py.cells import changed_to_msg
from ltm_msgs_py.grid import classes_to_msg, msg_to_classes
from ltm_msgs_py.stamp import ns_to_time
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.runtime.topics import (
    FUEL_MAP,
    FUEL_MAP_ANSWER,
    FUEL_MAP_QUERY,
    FUEL_MAP_REGION,
    FUEL_MAP_UPDATE,
    FUEL_VOTES,
    TERRAIN_CHANGE,
    TERRAIN_UPDATE,
    camera_topic,
    site_topic,
)

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

UPDATE = site_topic(NAME, FUEL_MAP_UPDATE)
NODE = f"/{NAME}/fuel_map"


class Living:
    """A fuel map that runs, and cameras that send to it."""

    def __init__(self, site: Path, folder: Path, runner: Runner, bystander: Bystander) -> None:
        self.folder, self.runner, self.bystander = folder, runner, bystander
        self.grid = grid_of(site)

    def send(self, *numbers: int, camera: str | None = None) -> None:
        for number in numbers:
            topic = camera_topic(NAME, camera or camera_of(number), FUEL_VOTES)
            self.bystander.send(topic, message(number, self.grid))

    def send_until_counted(self, owed: int, told: set[int]) -> None:
        """The first `owed` frames but those told of, again every few seconds: a busy reader loses some of a burst."""
        sent = -math.inf

        def all_there() -> bool:
            nonlocal sent
            if time.monotonic() - sent > 5.0:
                sent = time.monotonic()
                self.send(*(n for n in range(owed) if stamp_of_frame(n) not in told | self.told()))
            return self.bystander.count(NODE, "frames") == owed

        wait_for(all_there, f"{owed} frames", lambda: (self.bystander.summaries, len(self.told())))

    def told(self) -> set[int]:
        return set(self.bystander.stamps(UPDATE))

    def wait_told(self, *numbers: int) -> None:
        stamps = {stamp_of_frame(n) for n in numbers}
        wait_for(lambda: stamps <= self.told(), f"updates of {numbers}", lambda: self.bystander.summaries)


@pytest.fixture
def living(ros_domain: int, tmp_path: Path) -> Iterator[Living]:
    site, folder = write_site(tmp_path), tmp_path / "kept"
    parameters: dict[str, Any] = {
        "fuel_map": {"folder": str(folder), "accept_unknown_cameras": True, "allow_clear_and_burn": True}
    }
    whole = describe(load_site(site), site, parameters=parameters)
    runner = Runner(
        Graph(NAME, (whole.node("fuel_map"),)),
        domain_id=ros_domain,
        log_folder=tmp_path / "log",
        console=lambda line: None,
        policy=RestartPolicy(initial_s=0.1, maximum_s=1.0),
    )
    with runner, Bystander() as bystander:
        runner.wait_until_ready(120.0)
        bystander.listen(UPDATE, FUEL_MAP_UPDATE.type, depth=FUEL_MAP_UPDATE.depth)
        for camera in CAMERAS:
            bystander.open(camera_topic(NAME, camera, FUEL_VOTES), FUEL_VOTES.type)
        bystander.wait_for_wiring(1)
        yield Living(site, folder, runner, bystander)


def test_kills_under_load_lose_nothing_that_was_told_of(living: Living) -> None:
    process, owed = living.runner.processes["fuel_map"], 0
    for _ in range(3):
        starts = process.starts
        living.send(*range(owed, owed + 30))
        new = {stamp_of_frame(n) for n in range(owed, owed + 30)}
        wait_for(lambda stamps=new: living.told() & stamps, "an update")
        living.runner.kill("fuel_map")
        told = living.told()
        wait_for(lambda n=starts: process.starts == n + 1 and process.running, "restart the node")
        living.bystander.forget()
        living.bystander.wait_for_wiring(1)
        # The cameras send again what nobody told them of, and some more.
        owed += 30
        living.send(*range(0, owed, 7))
        living.send_until_counted(owed, told)
    with TileStore.open_read_only(living.folder / STORE_FILE, "fuel") as store:
        assert store.frame_count() == owed
        assert set(store.sources()) == set(CAMERAS)


def test_cameras_join_and_people_ask(living: Living) -> None:
    bystander = living.bystander
    bystander.open(camera_topic(NAME, "phone_7", FUEL_VOTES), FUEL_VOTES.type)
    bystander.wait_for_wiring(1)
    living.send(0, 1, 2)
    living.send(3, camera="phone_7")
    living.wait_told(0, 1, 2, 3)

    latest = bystander.wait_for_stamp(UPDATE, stamp_of_frame(3))
    corner, cells = latest.info.origin.position, np.array(latest.data).reshape(latest.info.height, latest.info.width)
    row, col = np.argwhere(cells > 0)[0]
    asked = PointStamped()
    asked.header.frame_id = "map"
    asked.point.x, asked.point.y = corner.x + 30.0 * col + 15.0, corner.y + 30.0 * row + 15.0
    answers = site_topic(NAME, FUEL_MAP_ANSWER)
    bystander.listen(answers, FUEL_MAP_ANSWER.type, latched=True)
    bystander.open(site_topic(NAME, FUEL_MAP_QUERY), PointStamped)
    bystander.wait_for_wiring(1)
    bystander.send(site_topic(NAME, FUEL_MAP_QUERY), asked)
    wait_for(lambda: bystander.heard[answers], "an answer")
    answer = json.loads(bystander.heard[answers][0].data)
    assert answer["seen_by"] >= 1
    assert answer["fuel"]["code"] > 0
    assert "phone_7" in {touch["camera"] for touch in answer["tile"]}

    maps = site_topic(NAME, FUEL_MAP)
    bystander.listen(maps, FUEL_MAP.type, latched=True)
    bystander.open(site_topic(NAME, FUEL_MAP_REGION), PolygonStamped)
    region = PolygonStamped()
    region.header.frame_id = "map"
    g = living.grid
    corners = ((g.x_min, g.y_min), (g.x_max, g.y_min), (g.x_max, g.y_max), (g.x_min, g.y_max))
    region.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
    assert bystander.call(f"{NODE}/clear")[0] is False
    wait_for(lambda: bystander.heard[maps] and (np.array(bystander.heard[maps][-1].data) > 0).any(), "the map")
    bystander.send(site_topic(NAME, FUEL_MAP_REGION), region)
    wait_for(lambda: bystander.call(f"{NODE}/clear")[0], "the region to be cleared")
    wait_for(lambda: (np.array(bystander.heard[maps][-1].data) == -1).all(), "an empty map")


@pytest.fixture
def wood(tmp_path: Path) -> Path:
    """Site file of a wood whose terrain is kept up to date in cells of 10 m."""
    plain = write_site(tmp_path)
    grid = load_site(plain).in_crs(grid_of(plain))
    write_geotiff(tmp_path / "prior.tif", np.full(grid.shape, 183, np.int16), grid, -9999)
    return write_site(tmp_path, fuel={"prior": "prior.tif"}, terrain={"resolution": 10.0})


def test_what_the_terrain_finds_comes_out_of_the_fuel_map(ros_domain: int, wood: Path, tmp_path: Path) -> None:
    """A felled stand, told while the map is up, and again to the map that comes back after a kill; and a fire."""
    site, folder = load_site(wood), tmp_path / "kept"
    fuel, terrain = grid_of(wood), terrain_grid(site.open_dem().geometry, 10.0)
    kinds = np.full(terrain.shape, int(ChangeKind.NONE), np.uint8)
    x, y = fuel.to_map(np.array([20, 24]), np.array([31, 36]))
    row, col = terrain.cell_of(x - 10, y + 10)
    kinds[row[0] : row[1], col[0] : col[1]] = ChangeKind.REMOVED
    stand = np.zeros(fuel.shape, bool)
    stand[20:24, 31:36] = True
    rows, cols = (part.astype(np.int32) for part in np.nonzero(kinds))
    changed = Changed(rows, cols, rows.astype(np.uint8) * 0, kinds[rows, cols], np.full(len(rows), -14.0, np.float32))
    stamp = stamp_of_frame(0)
    changes, updates = (site_topic(NAME, topic) for topic in (TERRAIN_CHANGE, TERRAIN_UPDATE))
    maps, regions = (site_topic(NAME, topic) for topic in (FUEL_MAP, FUEL_MAP_REGION))

    parameters: dict[str, Any] = {"fuel_map": {"folder": str(folder), "allow_clear_and_burn": True}}
    graph = Graph(NAME, (describe(site, wood, parameters=parameters).node("fuel_map"),))
    policy = RestartPolicy(initial_s=0.1, maximum_s=1.0)
    runner = Runner(graph, domain_id=ros_domain, log_folder=tmp_path / "log", console=lambda line: None, policy=policy)
    with runner, Bystander() as bystander:
        runner.wait_until_ready(120.0)
        bystander.listen(UPDATE, FUEL_MAP_UPDATE.type, depth=FUEL_MAP_UPDATE.depth)
        bystander.listen(maps, FUEL_MAP.type, latched=True)
        bystander.open(changes, TERRAIN_CHANGE.type, latched=True)
        bystander.open(updates, TERRAIN_UPDATE.type)
        bystander.open(regions, PolygonStamped)
        bystander.wait_for_wiring(1)
        heights = np.full(len(rows), 300.0, np.float32)
        bystander.send(updates, changed_to_msg(changed, heights, terrain, stamp))
        bystander.send(changes, classes_to_msg(kinds, terrain.translated(40.0, 0.0), stamp))  # of another site
        wait_for(
            lambda: bystander.count(NODE, "dropped.message") == 1, "the refusal", lambda: bystander.summaries[NODE]
        )
        bystander.send(changes, classes_to_msg(kinds, terrain, stamp))
        tile = bystander.wait_for_stamp(UPDATE, stamp)
        shown = np.array(tile.data).reshape(tile.info.height, tile.info.width) == LifeForm.GRASS
        about = reach_of(FusionRules())  # with the cells whose changes these may have a say in
        assert shown.shape == (4 + 2 * about, 5 + 2 * about)
        assert shown[about : about + 4, about : about + 5].all()
        assert shown.sum() == stand.sum()

        runner.kill("fuel_map")
        process = runner.processes["fuel_map"]
        wait_for(lambda: process.starts == 2 and process.running, "restart the node")
        bystander.heard[maps].clear()
        wait_for(lambda: bystander.heard[maps], "the map")  # the terrain's latched message comes again
        region = PolygonStamped()
        region.header.frame_id, region.header.stamp = "map", ns_to_time(stamp)
        corners = [fuel.to_map(r, c) for r, c in ((1.5, 1.5), (1.5, 9.5), (8.5, 9.5), (8.5, 1.5))]
        region.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
        bystander.forget()
        bystander.wait_for_wiring(1)
        bystander.send_until(
            lambda: bystander.send(regions, region), lambda: bystander.call(f"{NODE}/burn")[0], "the region to burn"
        )
        expected = np.where(stand, int(LifeForm.GRASS), int(LifeForm.TREE))
        expected[2:9, 2:10] = LifeForm.BURNED
        wait_for(lambda: np.array_equal(msg_to_classes(bystander.heard[maps][-1])[0], expected), "both in the map")
        assert bystander.stamps(UPDATE).count(stamp) == 2, "one of the stand, one of the fire"
