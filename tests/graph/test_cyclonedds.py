from __future__ import annotations

import contextlib
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bystander import Bystander
from scenes.small_site import NAME, TOWER, SmallSite

from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import DEPTH_IMAGE, POSED_CAMERA_INFO, POSED_POSE, camera_topic

pytest.importorskip("cyclonedds", reason="the dev extra is not installed")
pytestmark = pytest.mark.graph

LISTENER = Path(__file__).parent / "cyclone_listener.py"
# Loopback only, as our side; that has no multicast on every machine, so peers are asked one by one.
CYCLONE = """
<CycloneDDS><Domain>
  <General><Interfaces><NetworkInterface name="lo"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers>
  </Discovery>
</Domain></CycloneDDS>
"""
DEPTH = camera_topic(NAME, "tower", DEPTH_IMAGE)


def test_cyclone_takes_the_depth_that_ros_sees(
    small_site: SmallSite, ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each a little further to the right, so no two have the same depths.
    frames = [frame for frame in small_site.frames(60) if frame.camera_name == "tower"]
    whole = describe(small_site.site, small_site.path)
    graph = Graph(NAME, (whole.node("tower/depth"),))
    monkeypatch.setenv("CYCLONEDDS_URI", CYCLONE)
    with Runner(graph, domain_id=ros_domain, console=lambda line: None), Bystander() as bystander:
        listener = subprocess.Popen(
            [sys.executable, str(LISTENER), DEPTH], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        try:
            bystander.listen(DEPTH, DEPTH_IMAGE.type)
            for topic in (POSED_CAMERA_INFO, POSED_POSE):
                bystander.open(camera_topic(NAME, "tower", topic), topic.type)
            assert listener.stdout is not None
            assert listener.stdout.readline() == "ready\n", listener.communicate()[1]
            # Between two makes of DDS a match is complete only after the writer's next heartbeat, seconds later.
            for frame in frames:
                info = camera_to_msg(frame.camera, frame.stamp_ns, "tower_optical")
                bystander.send(camera_topic(NAME, "tower", POSED_CAMERA_INFO), info)
                bystander.send(camera_topic(NAME, "tower", POSED_POSE), pose_to_msg(frame.pose, frame.stamp_ns))
                with contextlib.suppress(subprocess.TimeoutExpired):
                    listener.wait(0.5)
                    break
            output, errors = listener.communicate(timeout=90)
            assert listener.returncode == 0, errors
            taken = json.loads(output)
            seen = bystander.wait_for_stamp(DEPTH, taken["stamp_ns"])
        finally:
            listener.kill()
            listener.communicate()
    data = bytes(seen.data)
    assert np.isfinite(np.frombuffer(data, np.float32)).mean() > 0.5
    assert taken == {
        "stamp_ns": stamp_of(seen),
        "size": [TOWER.height, TOWER.width],
        "encoding": "32FC1",
        "step": 4 * TOWER.width,
        "frame_id": "tower_optical",
        "sha256": hashlib.sha256(data).hexdigest(),
    }
