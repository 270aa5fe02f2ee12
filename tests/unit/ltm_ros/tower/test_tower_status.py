"""What a tower's state is, and which words are found for what is wrong."""

from __future__ import annotations

import pytest
from scenes.tower_words import NODES, healths, status_of, watch_of

from ltm_ros.tower.tower_status import KEYS, LENGTH, OutboxState, TowerWatch


def test_a_tower_that_has_not_begun_is_neither_alive_nor_ready() -> None:
    status = status_of(TowerWatch("ridge", NODES, 120.0))
    assert (status.alive, status.ready) == (False, False)
    assert {node.state for node in status.nodes} == {"missing"}
    assert any("/ridge/fuel_map no report yet" in line for line in status.wrong)
    assert any("north: no frame since the start" in line for line in status.wrong)


def test_what_is_wrong_is_said_in_words() -> None:
    status = status_of(watch_of(healths()))
    north, east = status.cameras
    assert (north.frame_age_s, north.dropped) == (4.5, {"shed": 3, "no_pose": 2})
    assert north.wrong == ""
    assert east.wrong == "east: no new frame for 12 min"
    assert status.alive
    assert not status.ready
    assert any("not synchronised" in line for line in status.wrong)
    assert any("/state: 2.0 GB free of 100 GB" in line for line in status.wrong)
    assert any("/gone: does not exist" in line for line in status.wrong)


def test_an_outbox_that_nobody_empties_is_said_in_words() -> None:
    made = healths()
    status = status_of(watch_of(made))
    assert status.outbox == OutboxState(412, 5_130_000, 7260.5, link_up=False)
    assert (
        "no connection to the region's map: 412 frames are queued in the outbox, the oldest for 2.0 h" in status.wrong
    )
    made["/ridge/uplink"].gauge("link_up", 1)
    assert not any("region" in line for line in status_of(watch_of(made)).wrong)
    assert status_of(TowerWatch("ridge", NODES, 120.0)).outbox is None


def test_a_doubted_pose_is_said_where_frames_come() -> None:
    made = healths()
    made["/ridge/east/capture"].gauge("newest_stamp", "1749999999.0")
    (said,) = [c.wrong for c in status_of(watch_of(made)).cameras if c.name == "east"]
    assert said == (
        "east: the pose is uncertain (pose_suspected: the skyline is 2.1 degrees off); "
        "check whether the mount has moved"
    )


@pytest.mark.parametrize(("now_s", "alive"), [(59.9, True), (60.1, False)])
def test_a_node_that_falls_silent_is_missed(now_s: float, alive: bool) -> None:
    status = status_of(watch_of(healths()), now_s)
    assert status.alive is alive
    assert {node.state for node in status.nodes} <= ({"ok", "troubled"} if alive else {"silent"})


def test_a_camera_clock_far_ahead_is_no_fresh_frame() -> None:
    made = healths()
    for camera in ("north", "east"):
        made[f"/ridge/{camera}/capture"].gauge("newest_stamp", "1749999999.0")
    assert status_of(watch_of(made)).ready
    made["/ridge/north/capture"].gauge("newest_stamp", "1750007300.0")
    (said,) = [c.wrong for c in status_of(watch_of(made)).cameras if c.name == "north"]
    assert not status_of(watch_of(made)).ready
    assert said == "north: the camera's clock is 2.0 h ahead of the system clock"


def test_strangers_are_not_listened_to_and_words_are_bounded() -> None:
    watch = TowerWatch("ridge", NODES, 120.0)
    watch.hear("/ridge/west/capture", False, "ok", {"frames_in": "1"}, 1.0)
    assert watch.reports == {}
    watch.hear(NODES[0], False, "x" * 10_000, {f"k{n}": "9" * 10_000 for n in range(10_000)}, 1.0)
    report = watch.reports[NODES[0]]
    assert len(report.values) == KEYS
    assert max(map(len, report.values.values())) == len(report.message) == LENGTH
    assert report.number("k1") is None, "a number too large to be one"
