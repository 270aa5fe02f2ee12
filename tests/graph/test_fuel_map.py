from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bystander import Bystander
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped
from scenes.fuel_frames import NAME, camera_of, grid_of, message, stamp_of_frame, write_site
from scenes.waiting import wait_for

from ltm_core.geometry.grid import GridGeometry
from ltm_core.site.site_io import load_site
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
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


def test_cameras_join_and_people_ask(ros_domain: int, tmp_path: Path) -> None:
    site = write_site(tmp_path)
    parameters = {"fuel_map": {"accept_unknown_cameras": True, "allow_clear_and_burn": True}}
    graph = Graph(NAME, (describe(load_site(site), site, parameters=parameters).node("fuel_map"),))
    with Runner(graph, domain_id=ros_domain, console=lambda line: None) as runner, Bystander() as bystander:
        runner.wait_until_ready(120.0)
        _join_and_ask(bystander, grid_of(site))


def _join_and_ask(bystander: Bystander, grid: GridGeometry) -> None:
    bystander.listen(UPDATE, FUEL_MAP_UPDATE.type, depth=FUEL_MAP_UPDATE.depth)
    cameras = [camera_of(0), camera_of(1), camera_of(2), "phone_7"]
    for camera in {*cameras}:
        bystander.open(camera_topic(NAME, camera, FUEL_VOTES), FUEL_VOTES.type)
    bystander.wait_for_wiring(1)
    for number, camera in enumerate(cameras):
        bystander.send(camera_topic(NAME, camera, FUEL_VOTES), message(number, grid))
    for number in range(len(cameras)):
        bystander.wait_for_stamp(UPDATE, stamp_of_frame(number))

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
    x0, y0, x1, y1 = grid.bounds
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    region.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
    assert bystander.call(f"{NODE}/clear")[0] is False
    wait_for(lambda: bystander.heard[maps] and (np.array(bystander.heard[maps][-1].data) > 0).any(), "the map")
    bystander.send(site_topic(NAME, FUEL_MAP_REGION), region)
    wait_for(lambda: bystander.call(f"{NODE}/clear")[0], "the region to be cleared")
    wait_for(lambda: (np.array(bystander.heard[maps][-1].data) == -1).all(), "an empty map")
