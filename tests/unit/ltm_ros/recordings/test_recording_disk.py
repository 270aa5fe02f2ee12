from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import serialize_message
from scenes.own_disk import run_on_own_disks
from std_msgs.msg import String

from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import Split
from ltm_ros.recordings.bounded_recording import BoundedRecording, RecordingLimits
from ltm_ros.runtime.health import Health

MINUTE_NS = 60 * 10**9
PROGRAM = Path(__file__).parents[3] / "scenes" / "recording_process.py"
CASES = ("full", "stopped_while_full", "floor", "killed")


@pytest.fixture(scope="module")
def on_disk(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """By case, of one process, whose start takes longer than a case."""
    return run_on_own_disks(PROGRAM, CASES, tmp_path_factory.mktemp("disk"))


def is_read_alike(read: dict[str, Any]) -> bool:
    return bool(read["ours"] == read["mcap"] == read["rosbags"] and not read["damage"])


def test_a_disk_that_fills_up_and_has_room_again(on_disk: dict[str, Any]) -> None:
    during, after, read = on_disk["full"]
    for state in (during, after):
        assert state["out"] + sum(state["dropped"].values()) == state["sent"]
        assert state["dropped"].keys() == {"disk"}
    assert during["troubled"]
    assert "No space left" in during["error"]
    assert during["dropped"] == after["dropped"]
    assert len(after["told"]) == 2, "one line when it stops, one when it goes on"
    assert "messages are lost" in after["told"][0]
    assert after["told"][1] == "recording continues"
    assert is_read_alike(read)
    assert len(read["ours"]) == after["out"]
    assert read["ours"][:31] == [*range(31)]
    assert read["ours"][-31:] == [*range(71, 102)]
    assert read["count"] == after["out"] + 2, "each file begins with the latched message"
    assert after["files"] == ["bag/bag_0.mcap", "bag/bag_1.mcap"]


def test_stopped_while_the_disk_is_full(on_disk: dict[str, Any]) -> None:
    state, read = on_disk["stopped_while_full"]
    assert state["out"] + sum(state["dropped"].values()) == state["sent"]
    assert is_read_alike(read)
    assert read["ours"] == [*range(state["out"])]
    assert state["out"] >= 31
    assert state["whole"]


def test_it_stops_above_a_floor_and_goes_on_by_itself(on_disk: dict[str, Any]) -> None:
    low, still_low, after, read = on_disk["floor"]
    assert (low["out"], low["dropped"], low["troubled"]) == (10, {"disk_low": 10}, True)
    assert low["read"] == [*range(10)], "the file is ended, and can be read meanwhile"
    assert "recording needs 8 MB; delete files" in low["error"]
    assert (still_low["out"], still_low["dropped"]) == (10, {"disk_low": 11}), "8.3 MB are free, 8.8 MB it takes"
    assert (after["out"], after["dropped"]) == (20, {"disk_low": 11})
    assert [line.partition(":")[0] for line in after["told"]] == ["recording stopped", "recording continues"]
    assert is_read_alike(read)
    assert read["ours"] == [*range(10), *range(21, 31)]


def test_a_killed_recorder_leaves_what_was_flushed_and_the_next_one_ends_its_bag(on_disk: dict[str, Any]) -> None:
    before, state, read, left = on_disk["killed"]
    assert before["ours"] == [*range(31)], "each second all is handed over; the last message was not yet"
    assert any("without a footer" in note for note in before["damage"])
    assert is_read_alike(read)
    assert read["ours"] == [*range(20)], "up to the last whole chunk of the file that was cut"
    assert read["count"] == 22
    assert left == ["metadata.yaml"]
    assert "was not finished" in state["told"][0]


def test_seven_days_stay_within_the_ring(tmp_path: Path) -> None:
    """Simulated time: three cameras with a picture a minute each; a file holds an hour, an operator marks one."""
    most, sent = 4_000_000, 0
    limits = RecordingLimits(most, 0, Split(most // 4, 3600 * 10**9))
    health, told = Health(), list[str]()
    recording = BoundedRecording(tmp_path / "bag", "/ridge/recorder", limits, health, told.append)
    cameras = [f"/ridge/{name}/image" for name in ("north", "east", "south")]
    for topic in cameras:
        recording.add_topic(topic, "std_msgs/msg/String", False)
    noise = random.Random(5)
    marked = tmp_path / "bag/bag_30.mcap"
    largest = 0
    for minute in range(7 * 24 * 60):
        for topic in cameras:
            text = f"{minute}:{noise.randbytes(60).hex()}"
            recording.write(
                topic, "std_msgs/msg/String", bytes(serialize_message(String(data=text))), minute * MINUTE_NS
            )
            sent += 1
        if minute % 30 == 0:
            recording.flush()
            files = list(tmp_path.rglob("*.mcap"))
            largest = max(largest, sum(file.stat().st_size for file in files if file != marked))
            if marked.exists():
                marked.with_name(f"{marked.name}.keep").touch()
    assert recording.close()
    assert most / 2 < largest <= most
    assert int(health.summary()["frames_out"]) == sent
    assert "dropped" not in "".join(told)
    minutes = [
        int(reader.decode(message).data.partition(":")[0])
        for reader in [BagReader(tmp_path / "bag")]
        for message in reader.messages([cameras[0]])
    ]
    hour = [*range(30 * 60, 31 * 60)]
    assert minutes[:60] == hour, "the marked one is whole"
    assert minutes[60:] == [*range(minutes[60], 7 * 24 * 60)], "and the newest are, without a gap"
    assert int(health.summary()["noted.files_removed"]) > 30
