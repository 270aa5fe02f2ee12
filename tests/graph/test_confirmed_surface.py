"""Depth follows the confirmed surface in the living graph, also when its process is killed."""

from __future__ import annotations

from pathlib import Path

import pytest
from bystander import Bystander
from scenes.small_site import BEGIN_NS, NAME
from scenes.terrain_frames import HOUR, measured_messages, sunk, write_terrain_site
from scenes.waiting import wait_for

from ltm_msgs_py.cells import msg_to_traced, msg_to_version
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.runtime.topics import (
    DEPTH_INFO,
    MEASURED_DEPTH,
    MEASURED_SIGMA,
    POSED_CAMERA_INFO,
    POSED_POSE,
    TERRAIN_SURFACE,
    camera_topic,
    site_topic,
)

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

SURFACE, INFO = site_topic(NAME, TERRAIN_SURFACE), camera_topic(NAME, "mast", DEPTH_INFO)
PARTS = (POSED_CAMERA_INFO, POSED_POSE, MEASURED_SIGMA, MEASURED_DEPTH)


def test_a_killed_depth_node_comes_back_to_the_version_that_counts_until_it_is_taken_back(
    ros_domain: int, tmp_path: Path
) -> None:
    terrain = {"trace_confirmed": True}
    nodes = {"terrain": {"max_behind": 1e9, "folder": "kept", "depth_from_elsewhere": True}}
    small = write_terrain_site(tmp_path, False, terrain=terrain, nodes=nodes)
    whole = describe(small.site, small.path)
    label = "cameras"
    runner = Runner(
        Graph(NAME, (whole.node("terrain"), whole.node("mast/depth"))),
        domain_id=ros_domain,
        console=lambda line: None,
        policy=RestartPolicy(initial_s=0.1, maximum_s=1.0),
    )
    with runner, Bystander() as bystander:
        runner.wait_until_ready(300.0)
        bystander.listen(SURFACE, TERRAIN_SURFACE.type, latched=True)
        bystander.listen(INFO, DEPTH_INFO.type)
        for topic in PARTS:
            both = topic in (POSED_CAMERA_INFO, POSED_POSE)
            bystander.open(camera_topic(NAME, "mast", topic), topic.type, listeners=1 + both)
        bystander.wait_for_wiring(2)

        def versions() -> dict[int, str]:
            return dict(msg_to_traced(message) for message in list(bystander.heard[INFO]))

        def look(hours: int) -> str:
            stamp = BEGIN_NS + hours * HOUR
            messages = measured_messages(small, sunk(small), stamp)

            def send() -> None:
                for topic in PARTS:
                    bystander.send(camera_topic(NAME, "mast", topic), messages[topic])

            bystander.send_until(send, lambda: stamp in versions(), f"depth of {stamp}")
            return versions()[stamp]

        def told() -> str:
            return msg_to_version(bystander.heard[SURFACE][-1])

        assert look(0) == ""
        assert look(2) == ""
        wait_for(lambda: bystander.heard[SURFACE] and told(), "a confirmed surface", lambda: bystander.summaries)
        process = runner.processes[label]
        starts = process.starts
        runner.kill(label)
        wait_for(lambda: process.starts > starts and process.running, "the process again")
        bystander.forget()
        bystander.wait_for_wiring(2)
        counts = told()
        traced = look(4)
        assert traced, "it is back to the terrain as given"
        assert traced in (counts, told())  # which this very frame may have changed
        take_back = f"/{NAME}/terrain/take_back"
        done, answer = bystander.call(take_back)
        assert done, answer
        wait_for(lambda: not (told() and bystander.call(take_back)), "all versions to be taken back")
        depth = f"/{NAME}/mast/depth"
        wait_for(lambda: bystander.summaries[depth].get("surface") == "as given", "depth to follow")
        assert look(6) == ""
