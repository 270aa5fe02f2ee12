"""Kill -9 at any moment, again and again: what was acknowledged is there, nothing is there twice."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from scenes.fuel_frames import LABELS, camera_of, grid_of, message, write_site
from scenes.outlets import Kept

from ltm_core.fuel.cell_state import EVIDENCE_FIELDS
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, open_stored_map
from ltm_core.site.site_io import load_site
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime.health import Health

TESTS = Path(__file__).parents[1]
AHEAD = 25
"""Frames that are sent before the first of them is acknowledged, at most."""


class Aggregator:
    """A process of the fuel map, and what it has acknowledged."""

    def __init__(self, site: Path, folder: Path, owed: int) -> None:
        """`owed`: the first frame that has not been acknowledged yet."""
        self._owed = owed
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS), str(TESTS.parent)])}
        self._process = subprocess.Popen(
            [sys.executable, str(TESTS / "scenes" / "fuel_map_process.py"), str(site), str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"
        self.acknowledged: list[int] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def send(self, number: int) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{number}\n")
        self._process.stdin.flush()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()  # what it said before it died counts

    def finish(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        assert self._process.wait(60) == 0
        self._reader.join()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.endswith("\n") and int(line) >= self._owed:
                self.acknowledged.append(int(line))


def run_with_kills(site: Path, folder: Path, cycles: int, seed: int) -> int:
    """Send frames in order while the process is killed; after each kill, the first that is not acknowledged comes
    again, and some that are. The number of frames sent in all.
    """
    rng = random.Random(seed)
    owed = 0
    for cycle in range(cycles + 1):
        aggregator = Aggregator(site, folder, owed)
        for number in rng.sample(range(owed), min(owed, 3)):
            aggregator.send(number)
        last = owed + (rng.randrange(1, 40) if cycle < cycles else 5)
        following = owed
        deadline = time.monotonic() + 60
        while owed + len(aggregator.acknowledged) < last and time.monotonic() < deadline:
            if following < owed + len(aggregator.acknowledged) + AHEAD:
                aggregator.send(following)
                following += 1
            else:
                time.sleep(0.0005)  # paces the sender
        if cycle < cycles:
            time.sleep(rng.random() * 0.03)  # waits for nothing: it chooses the moment
            aggregator.kill()
        else:
            for number in range(following, following + 3):
                aggregator.send(number)
            aggregator.finish()
        # Each once and in order, or a kill would have to be followed by more than the frames from the first one owed.
        assert aggregator.acknowledged == list(range(owed, owed + len(aggregator.acknowledged)))
        owed += len(aggregator.acknowledged)
    return owed


@pytest.mark.parametrize("cycles", [2, pytest.param(200, marks=pytest.mark.slow)])
def test_state_is_that_of_a_run_without_kills(tmp_path: Path, cycles: int) -> None:
    site = write_site(tmp_path)
    frames = run_with_kills(site, tmp_path / "kept", cycles, seed=cycles)
    assert frames > 5 * cycles
    whole = FuelMapHandler(FuelMapConfig(site=str(site)), Kept(), Health())
    grid = grid_of(site)
    for number in range(frames):
        whole.on_votes(camera_of(number), message(number, grid))
    whole.finish()
    config = load_site(site)
    empty = site_evidence_map(config, grid, LABELS)
    initial = empty.layers()
    with open_stored_map(tmp_path / "kept" / STORE_FILE, config, empty) as store:
        assert store.frame_count() == frames
        assert sum(store.sources().values()) == frames
        assert store.waiting() == []
        expected = whole.persistence.map
        for row, col in np.ndindex(expected.tiles):
            found, wanted = empty.tile_state((row, col)), expected.tile_state((row, col))
            for name in EVIDENCE_FIELDS:
                np.testing.assert_array_equal(found[name], wanted[name], err_msg=name)
        for layer in ("life_form", "code"):
            journal = store.as_of(layer, getattr(initial, layer), 2**62)
            np.testing.assert_array_equal(journal, getattr(expected.layers(), layer))
