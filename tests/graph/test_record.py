import signal
import subprocess
import sys
from pathlib import Path

import pytest
from bystander import Bystander
from scenes.small_site import BEGIN_NS, NAME, TOWER, SmallSite
from scenes.waiting import wait_for
from std_msgs.msg import String

from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.topics import CAMERA_INFO, LABELS_INFO, POSE, camera_topic

pytestmark = pytest.mark.graph

LTM = "from ltm_ros.cli.main import app; app()"
COUNT = 20


def test_records_what_it_is_asked_for(
    small_site: SmallSite, ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    pose, info, latched = (camera_topic(NAME, "tower", topic) for topic in (POSE, CAMERA_INFO, LABELS_INFO))
    command = [sys.executable, "-c", LTM, "record", "--site", str(small_site.path)]
    command += ["--out", str(tmp_path / "bag"), f"/{NAME}/*/pose", latched]
    with Bystander() as bystander:
        palette = bystander.node.create_publisher(String, latched, stream_qos(latched=True))
        palette.publish(String(data="from before the recording"))
        recorder = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        try:
            bystander.open(pose, POSE.type)
            bystander.open(info, CAMERA_INFO.type, listeners=0)
            wait_for(lambda: palette.get_subscription_count() == 1, "the recorder at the latched topic")
            # It has matched us; its own word that it takes what we send:
            tries = 0
            while bystander.count(f"/{NAME}/recorder", "frames_in") == 0:
                bystander.send(pose, pose_to_msg(small_site.tower_pose(0.0), tries))
                wait_for(lambda: bystander.summaries.pop(f"/{NAME}/recorder", None) is not None, "diagnostics")
                wait_for(lambda: f"/{NAME}/recorder" in bystander.summaries, "newer diagnostics")
                tries += 1
            before = bystander.count(f"/{NAME}/recorder", "frames_in")
            for i in range(COUNT):
                bystander.send(info, camera_to_msg(TOWER, BEGIN_NS + i, "tower_optical"))
                bystander.send(pose, pose_to_msg(small_site.tower_pose(float(i)), BEGIN_NS + i))
                if i % 7 == 6:  # a publisher keeps its last ten, so a burst could outrun the reader
                    wait_for(
                        lambda n=before + i: bystander.count(f"/{NAME}/recorder", "frames_in") >= n,
                        f"{i + 1} poses at the recorder",
                        lambda: bystander.summaries,
                    )
            wait_for(
                lambda: bystander.count(f"/{NAME}/recorder", "frames_out") >= COUNT + 1,
                f"{COUNT} poses",
                lambda: bystander.summaries,
            )
            recorder.send_signal(signal.SIGINT)
            output, _ = recorder.communicate(timeout=60)
        finally:
            recorder.kill()
            recorder.communicate()
    assert recorder.returncode == 0, output
    reader = BagReader(tmp_path / "bag", allow_damaged=False)
    assert {*reader.topics()} == {pose, latched}
    assert reader.topic_infos()[latched].latched
    assert [reader.decode(m).data for m in reader.messages([latched])] == ["from before the recording"]
    poses = [reader.decode(m) for m in reader.messages([pose])]
    later = [message for message in poses if stamp_of(message) >= BEGIN_NS]
    assert later == [pose_to_msg(small_site.tower_pose(float(i)), BEGIN_NS + i) for i in range(COUNT)]
