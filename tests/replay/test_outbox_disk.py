from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from scenes.own_disk import run_on_own_disks

PROGRAM = Path(__file__).parents[1] / "scenes" / "outbox_disk_process.py"
States = dict[str, list[dict[str, Any]]]


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> States:
    """By case: what a tower whose outbox is on a disk of its own says of itself, and what is in the file, step by
    step. Of one process, whose start takes longer than a case."""
    folder = tmp_path_factory.mktemp("outbox_disk")
    disk, scene = folder / "disk", folder / "scene"
    disk.mkdir()
    scene.mkdir()
    states = run_on_own_disks(PROGRAM, ("full", "read_only"), disk, scene)
    assert all(state["dropped"] == {} for case in states.values() for state in case), "no frame is lost"
    return states


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
