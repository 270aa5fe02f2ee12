import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bystander import Bystander
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped
from scenes.fuel_frames import CAMERAS, NAME, camera_of, grid_of, message, stamp_of_frame, votes, write_grass_site
from scenes.waiting import wait_for

from ltm_core.fuel.life_form import LifeForm
from ltm_core.site.site_io import load_site
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

    def send(self, *numbers: int) -> None:
        for number in numbers:
            topic = camera_topic(NAME, camera_of(number), FUEL_VOTES)
            self.bystander.send(topic, message(number, self.grid))

    def told(self) -> set[int]:
        return set(self.bystander.stamps(UPDATE))

    def wait_told(self, *numbers: int) -> None:
        stamps = {stamp_of_frame(n) for n in numbers}
        wait_for(lambda: stamps <= self.told(), f"updates of {numbers}", lambda: self.bystander.summaries)


@pytest.fixture
def living(ros_domain: int, tmp_path: Path) -> Iterator[Living]:
    site, folder = write_grass_site(tmp_path), tmp_path / "kept"
    parameters: dict[str, Any] = {"fuel_map": {"folder": str(folder), "allow_burn": True}}
    whole = describe(load_site(site), site, parameters=parameters)
    runner = Runner(
        Graph(NAME, (whole.node("fuel_map"),)),
        domain_id=ros_domain,
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


def test_cameras_join_and_people_ask(living: Living) -> None:
    bystander = living.bystander
    living.send(0, 1, 2, 3)
    living.wait_told(0, 1, 2, 3)

    seen, g = votes(3, living.grid), living.grid
    asked = PointStamped()
    asked.header.frame_id = "map"
    asked.point.x, asked.point.y = g.x_min + 30.0 * seen.cols[0] + 15.0, g.y_max - 30.0 * seen.rows[0] - 15.0
    answers = site_topic(NAME, FUEL_MAP_ANSWER)
    bystander.listen(answers, FUEL_MAP_ANSWER.type, latched=True)
    bystander.open(site_topic(NAME, FUEL_MAP_QUERY), PointStamped)
    bystander.wait_for_wiring(1)
    bystander.send(site_topic(NAME, FUEL_MAP_QUERY), asked)
    wait_for(lambda: bystander.heard[answers], "an answer")
    answer = json.loads(bystander.heard[answers][0].data)
    assert answer["seen_by"] >= 1
    assert answer["fuel"]["code"] > 0
    assert {touch["camera"] for touch in answer["tile"]} == {camera_of(number) for number in range(4)}

    maps = site_topic(NAME, FUEL_MAP)
    bystander.listen(maps, FUEL_MAP.type, latched=True)
    bystander.open(site_topic(NAME, FUEL_MAP_REGION), PolygonStamped)
    region = PolygonStamped()
    region.header.frame_id = "map"
    corners = ((g.x_min, g.y_min), (g.x_max, g.y_min), (g.x_max, g.y_max), (g.x_min, g.y_max))
    region.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
    assert bystander.call(f"{NODE}/burn")[0] is False
    wait_for(lambda: bystander.heard[maps] and (np.array(bystander.heard[maps][-1].data) > 0).any(), "the map")
    bystander.send(site_topic(NAME, FUEL_MAP_REGION), region)
    wait_for(lambda: bystander.call(f"{NODE}/burn")[0], "the region to be burned")
    burned = int(LifeForm.BURNED)
    wait_for(lambda: (np.array(bystander.heard[maps][-1].data) == burned).all(), "a burned map")
