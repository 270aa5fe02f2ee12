from pathlib import Path
from typing import Any

import pytest
from scenes.own_disk import run_on_own_disks

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
