"""A tower's outbox on a disk that is full, read-only, slow or out of inodes: told, nothing corrupt, nothing lost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from scenes.own_disk import run_on_own_disks

PROGRAM = Path(__file__).parents[1] / "scenes" / "outbox_disk_process.py"
States = dict[str, list[dict[str, Any]]]


def states_of(cases: tuple[str, ...], folder: Path, more: dict[str, str] | None = None) -> States:
    """By case: what a tower whose outbox is on a disk of its own says of itself, and what is in the file, step by
    step."""
    disk, scene = folder / "disk", folder / "scene"
    disk.mkdir()
    scene.mkdir()
    states = run_on_own_disks(PROGRAM, cases, disk, scene, more=more)
    assert all(state["dropped"] == {} for case in states.values() for state in case), "no frame is lost"
    return states


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> States:
    """Of one process, whose start takes longer than a case."""
    return states_of(("full", "read_only", "no_inodes"), tmp_path_factory.mktemp("outbox_disk"))


def test_disk_that_fills_up(states: States) -> None:
    before, during, after = states["full"]
    assert (before["frames"], before["troubled"]) == ([0, 1, 2], False)
    assert 3 <= during["kept"] < 40
    assert during["frames"] == list(range(during["kept"])), "what is told to be kept is in the file, whole"
    assert during["troubled"]
    assert "SQLITE_FULL" in during["error"]
    assert (after["kept"], after["frames"]) == (40, list(range(40)))


def test_a_tower_that_starts_on_a_read_only_disk_keeps_its_frames_in_memory(states: States) -> None:
    during, after = states["read_only"]
    assert (during["kept"], during["frames"], during["troubled"]) == (0, [0, 1, 2], True)
    assert "ead-only" in during["error"]
    assert (after["kept"], after["frames"]) == (4, list(range(7)))


def test_disk_without_room_for_another_name(states: States) -> None:
    running, started, after = states["no_inodes"]
    assert (running["frames"], running["troubled"]) == (list(range(6)), False), "its files are there already"
    assert (started["kept"], started["troubled"]) == (0, True)
    assert "No space left on device" in started["error"]
    assert after["frames"] == list(range(10))
