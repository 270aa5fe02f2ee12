from pathlib import Path
from typing import Any

import pytest
from scenes.fuel_frames import write_site
from scenes.own_disk import run_on_own_disks

PROGRAM = Path(__file__).parents[1] / "scenes" / "disk_process.py"
CASES = ("full", "stopped_while_full", "full_from_the_start")
FRAMES = 30
MANY = 150
States = dict[str, list[dict[str, Any]]]


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> States:
    """By case: what a node on a disk of its own says of itself, step by step. One process for all, whose start takes
    longer than a case."""
    folder = tmp_path_factory.mktemp("fuel_map_disk")
    (folder / "disk").mkdir()
    return run_on_own_disks(PROGRAM, CASES, folder / "disk", write_site(folder))


def test_disk_that_fills_up(states: States) -> None:
    before, soon, during, after, restarted = states["full"]
    assert (before["frames"], before["unsaved"], before["troubled"]) == (3, 0, False)
    assert (soon["frames"], soon["unsaved"], soon["updates"]) == (6, 0, 6), "in the room that the store holds"
    assert soon["troubled"]
    assert "full" in soon["error"]
    assert "reserved space" in soon["error"]
    assert during["unsaved"] > 0, "half of that room is for the end"
    assert during["frames"] + during["unsaved"] == FRAMES
    assert during["troubled"]
    assert "in memory only" in during["error"]
    assert during["updates"] == during["frames"], "nothing is told of that is not stored"
    assert (after["frames"], after["unsaved"], after["updates"]) == (FRAMES, 0, FRAMES)
    assert (restarted["frames"], restarted["unsaved"], restarted["troubled"]) == (FRAMES, 0, False)


def test_a_node_that_is_stopped_on_a_full_disk_writes_all(states: States) -> None:
    during, stopped, restarted = states["stopped_while_full"]
    assert during["unsaved"] > 0
    assert (stopped["frames"], stopped["unsaved"], stopped["updates"]) == (MANY, 0, MANY)
    assert (restarted["frames"], restarted["unsaved"]) == (MANY, 0)


def test_disk_that_is_full_when_the_node_starts(states: States) -> None:
    during, after = states["full_from_the_start"]
    assert (during["frames"], during["unsaved"], during["troubled"]) == (0, 3, True)
    assert "disk" in during["error"]
    assert (after["frames"], after["unsaved"], after["updates"]) == (3, 0, 3)
