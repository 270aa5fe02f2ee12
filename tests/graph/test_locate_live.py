"""Locating as a process on real DDS: regions and a person's point go in; estimates, tracks and refusals come out."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bystander import Bystander
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped
from scenes.located import CAMERA, hills, sighting
from scenes.waiting import wait_for

from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_msgs_py.pose import correction_to_msg, pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import make_header
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.topics import (
    LOCATE_ESTIMATE,
    LOCATE_FIX,
    LOCATE_FUSED,
    LOCATE_POINT,
    LOCATE_REGION,
    LOCATE_TRACKS,
    POSE_CORRECTION,
    POSED_CAMERA_INFO,
    POSED_POSE,
    camera_topic,
    site_topic,
)

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

SITE = "hollow"
FIRE = np.array([-100.0, 2480.0, 64.0])
TOWERS = {"north": (-900.0, 1300.0, 180.0), "east": (1200.0, 1700.0, 190.0)}
SECOND = 1_000_000_000
NODE = f"/{SITE}/locate"


def write_site(folder: Path) -> Path:
    dem = hills()
    g = dem.geometry
    moved = g.translated(4e5, 38e5, crs="EPSG:32611")
    Dem(dem.elevation, moved).save(folder / "dem.tif")
    content = {
        "name": SITE,
        "crs": "EPSG:32611",
        "origin": [4e5, 38e5],
        "dem": {"path": "dem.tif"},
        "cameras": {name: {} for name in TOWERS},
        "locating": {},
        "expert": {"curvature": False, "locating": {"dem_sigma": 0.5}},
        "refine_poses": {},
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def of(camera: str, topic: Topic) -> str:
    return camera_topic(SITE, camera, topic)


def test_marks_of_two_cameras_become_one_place(ros_domain: int, tmp_path: Path) -> None:
    path = write_site(tmp_path)
    begin = time.time_ns() - 10 * SECOND  # stamps of long ago are refused
    whole = describe(load_site(path), path)
    graph = Graph(SITE, (whole.node("locate"),))
    seen = {name: sighting(name, tower, FIRE, 0.05) for name, tower in TOWERS.items()}
    runner = Runner(graph, domain_id=ros_domain, console=lambda line: None)
    with runner, Bystander() as bystander:
        runner.wait_until_ready(300.0)
        tracks, fused = site_topic(SITE, LOCATE_TRACKS), site_topic(SITE, LOCATE_FUSED)
        bystander.listen(tracks, LOCATE_TRACKS.type, latched=True)
        bystander.listen(fused, LOCATE_FUSED.type)
        for name in TOWERS:
            bystander.listen(of(name, LOCATE_ESTIMATE), LOCATE_ESTIMATE.type)
            bystander.listen(of(name, LOCATE_FIX), LOCATE_FIX.type)
            for topic in (POSED_CAMERA_INFO, POSED_POSE, POSE_CORRECTION, LOCATE_REGION, LOCATE_POINT):
                bystander.open(of(name, topic), topic.type, latched=topic.latched)
        bystander.wait_for_wiring(1)

        def mark(name: str, stamp: int) -> PolygonStamped:
            u, v = (float(x) for x in seen[name].mark.pixels[0])
            message = PolygonStamped(header=make_header(stamp, f"{name}_optical"))
            corners = [(u - 6, v - 18), (u + 6, v - 18), (u + 6, v), (u - 6, v)]
            message.polygon.points = [Point32(x=x, y=y, z=0.0) for x, y in corners]
            return message

        # Nothing is known of the camera yet: told, and the node lives.
        bystander.send(of("north", LOCATE_REGION), mark("north", begin))
        wait_for(lambda: bystander.count(NODE, "dropped") >= 1, "the region without a pose to be counted")

        # Pose and mark come on different topics, in any order, and may be lost: sent again until there is an answer.
        def located(name: str, stamp: int, topic: Topic, message: PolygonStamped | PointStamped) -> bool:
            if stamp in bystander.stamps(of(name, LOCATE_ESTIMATE)):
                return True
            bystander.send(of(name, POSED_CAMERA_INFO), camera_to_msg(CAMERA, begin, f"{name}_optical"))
            bystander.send(of(name, POSED_POSE), pose_to_msg(seen[name].pose, begin, covariance=seen[name].covariance))
            bystander.send(of(name, topic), message)
            return False

        wait_for(lambda: located("north", begin, LOCATE_REGION, mark("north", begin)), "an estimate of north")
        wait_for(lambda: bystander.heard[of("north", LOCATE_FIX)], "its fix")
        # A person's point in the other camera's picture enters the same track.
        stamp = begin + SECOND
        point = PointStamped(header=make_header(stamp, "east_optical"))
        point.point.x, point.point.y = (float(x) for x in seen["east"].mark.pixels[0])
        wait_for(lambda: located("east", stamp, LOCATE_POINT, point), "an estimate of east")
        place = bystander.wait_for_stamp(fused, stamp).pose.pose.position
        assert (place.x, place.y) == pytest.approx(tuple(FIRE[:2]), abs=15)

        def told() -> Any:
            heard = bystander.heard[tracks]
            newest = json.loads(heard[-1].data)["features"] if heard else []
            return newest[0]["properties"] if newest else {}

        wait_for(lambda: told().get("sources") == ["detector", "person"], "the track's two sources")
        assert told()["seen_by"] == ["north", "east"]
        # Smoke is asked for here: who sees the place and where to turn them stands in the track.
        assert {view["camera"] for view in told()["cameras"]} == set(TOWERS)

        # The node `pose` of north reports that the camera's direction is no longer known.
        unknown = correction_to_msg(PoseCorrection(np.zeros(3), np.eye(3) * 4.0), stamp + SECOND)

        def named() -> Any:
            bystander.send(of("north", POSE_CORRECTION), unknown)
            return json.loads(bystander.heard[tracks][-1].data)["turned"]

        wait_for(named, "north to be named by its pictures")
        assert (named()["camera"], named()["by"]) == ("north", ["pictures"])
