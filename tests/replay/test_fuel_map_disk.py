"""A disk that is full, read-only, or not there: the map lives on, says so, and loses nothing that it had told of."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from scenes.fuel_frames import write_site

TESTS = Path(__file__).parents[1]
FRAMES = 30


def states_of(case: str, folder: Path) -> list[dict[str, Any]]:
    """What a node on a disk of its own says of itself, step by step."""
    if shutil.which("unshare") is None:
        pytest.skip("needs `unshare` for a file system of its own")
    site = write_site(folder)
    disk = folder / "disk"
    disk.mkdir()
    alone = ["unshare", "-m"] if os.geteuid() == 0 else ["unshare", "--user", "--map-root-user", "-m"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS), str(TESTS.parent)])}
    command = [*alone, sys.executable, str(TESTS / "scenes" / "disk_process.py"), case, str(site), str(disk)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    if done.returncode != 0 and "unshare" in done.stderr:
        pytest.skip(f"no mount namespace here: {done.stderr.strip()[:200]}")
    assert done.returncode == 0, done.stderr[-3000:]
    said = json.loads(done.stdout.splitlines()[-1])
    if "no mounts here" in said:
        pytest.skip(f"cannot mount a file system here: {said['no mounts here'][:200]}")
    assert "refused" not in said, said
    states: list[dict[str, Any]] = said["states"]
    return states


def test_disk_that_fills_up(tmp_path: Path) -> None:
    before, during, after, restarted = states_of("full", tmp_path)
    assert (before["frames"], before["unsaved"], before["troubled"]) == (3, 0, False)
    assert during["unsaved"] > 10
    assert during["frames"] + during["unsaved"] == FRAMES
    assert during["troubled"]
    assert "full" in during["error"]
    assert "in memory only" in during["error"]
    assert during["updates"] == during["frames"], "nothing is told of that is not stored"
    assert (after["frames"], after["unsaved"], after["updates"]) == (FRAMES, 0, FRAMES)
    assert (restarted["frames"], restarted["unsaved"], restarted["troubled"]) == (FRAMES, 0, False)


def test_disk_that_is_full_when_the_node_starts(tmp_path: Path) -> None:
    during, after = states_of("full_from_the_start", tmp_path)
    assert (during["frames"], during["unsaved"], during["troubled"]) == (0, 3, True)
    assert "disk" in during["error"]
    assert (after["frames"], after["unsaved"], after["updates"]) == (3, 0, 3)


def test_disk_that_turns_read_only(tmp_path: Path) -> None:
    before, during, after = states_of("read_only", tmp_path)
    assert before["frames"] == 3
    assert (during["frames"], during["unsaved"], during["troubled"]) == (0, 3, True)
    assert "ead-only" in during["error"]
    assert (after["frames"], after["unsaved"]) == (6, 0)
