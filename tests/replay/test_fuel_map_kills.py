"""The fuel map's process is killed at any moment: what it acknowledged is stored, and nothing is counted twice.

Run as a program, `python test_fuel_map_kills.py SITE FOLDER`, this file is that process. It reads numbers of frames and
prints each number when the frame is acknowledged or already known.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes.fuel_frames import BEGIN_NS, LABELS, PERIOD_NS, camera_of, grid_of, message, write_site
from scenes.outlets import Kept

from ltm_core.fuel.cell_state import EVIDENCE_FIELDS
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, open_stored_map
from ltm_core.site.site_io import load_site
from ltm_ros.fuel_map import persistence
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE

TESTS = Path(__file__).parents[1]
MOST_SENT = 40


class Printed(Kept):
    """Print the number of every frame whose update is published, which is after it is stored."""

    def publish(self, topic: Topic, sent: Any) -> None:
        if topic is FUEL_MAP_UPDATE:
            stamp = sent.header.stamp
            print((stamp.sec * 10**9 + stamp.nanosec - BEGIN_NS) // PERIOD_NS, flush=True)


def main(site: Path, folder: Path) -> None:
    persistence.LOGGED_FRAMES = 7  # tiles are written often, so that kills interrupt it
    grid, health = grid_of(site), Health()
    handler = FuelMapHandler(FuelMapConfig(site=str(site), folder=str(folder)), Printed(), health)
    handler.start()
    for line in iter(sys.stdin.readline, ""):
        known = health.dropped.get("duplicate", 0)
        handler.on_votes(camera_of(int(line)), message(int(line), grid))
        if health.dropped.get("duplicate", 0) > known:
            print(int(line), flush=True)
        if int(line) % 3 == 0:
            handler.idle()  # stores what has come, and acknowledges it
    handler.finish()


def acknowledged(site: Path, folder: Path, numbers: list[int], kill_after: int | None, pause: float) -> list[int]:
    """Send frames to a process; what it acknowledged until it ended, or was killed `pause` s after `kill_after`."""
    process = subprocess.Popen(
        [sys.executable, __file__, str(site), str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS), str(TESTS.parent)])},
    )
    with process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.writelines(f"{number}\n" for number in numbers)
        process.stdin.flush()
        if kill_after is None:
            rest, _ = process.communicate(timeout=120)
            assert process.returncode == 0
            return [int(line) for line in rest.split()]
        lines = [process.stdout.readline() for _ in range(kill_after)]
        time.sleep(pause)  # waits for nothing: it chooses the moment
        process.kill()
        lines += process.stdout.readlines()
    return [int(line) for line in lines if line.endswith("\n")]


@pytest.mark.parametrize("cycles", [2, pytest.param(40, marks=pytest.mark.slow)])
def test_state_is_that_of_a_run_without_kills(tmp_path: Path, cycles: int) -> None:
    site, rng, frames = write_site(tmp_path), random.Random(cycles), 0
    for cycle in range(cycles + 1):
        again = rng.sample(range(frames), min(frames, 3))
        numbers = [*again, *range(frames, frames + MOST_SENT)]
        kill_after = len(again) + rng.randrange(1, 20) if cycle < cycles else None
        found = acknowledged(site, tmp_path / "kept", numbers, kill_after, rng.random() * 0.03)
        new = [number for number in found if number >= frames]
        assert new == list(range(frames, frames + len(new))), "each once and in order"
        assert sorted(again) == sorted(number for number in found if number < frames), "what is stored stays known"
        frames += len(new)
    assert frames > MOST_SENT
    whole = FuelMapHandler(FuelMapConfig(site=str(site)), Kept(), Health())
    grid, config = grid_of(site), load_site(site)
    for number in range(frames):
        whole.on_votes(camera_of(number), message(number, grid))
    whole.finish()
    stored = site_evidence_map(config, grid, LABELS)
    initial, expected = stored.layers(), whole.persistence.map
    with open_stored_map(tmp_path / "kept" / STORE_FILE, config, stored) as store:
        assert (store.frame_count(), store.waiting()) == (frames, [])
        assert sum(store.sources().values()) == frames
        for row, col in np.ndindex(expected.tiles):
            found_tile, wanted = stored.tile_state((row, col)), expected.tile_state((row, col))
            for name in EVIDENCE_FIELDS:
                np.testing.assert_array_equal(found_tile[name], wanted[name], err_msg=name)
        for layer in ("life_form", "code"):
            journal = store.as_of(layer, getattr(initial, layer), 2**62)
            np.testing.assert_array_equal(journal, getattr(expected.layers(), layer))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
