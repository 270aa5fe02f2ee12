"""The verdict of a chaos run finds what it is there to find."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chaos.cameras import CAMERAS, PHASES, Sent
from chaos.living_site import write_living_site
from chaos.stranger import ATTACKS, Stranger
from chaos.verdict import Verdict, judge
from scenes.outlets import Kept
from scenes.small_site import SmallSite

from ltm_core.base.errors import MessageError
from ltm_core.fuel.votes import CellVotes
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.pointcloud import msg_to_votes, votes_to_msg
from ltm_msgs_py.stamp import ns_to_time
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE

BEGIN_NS = 1_700_000_000_000_000_000
FRAMES = [Sent(CAMERAS[n % 2], n // 2 % PHASES, BEGIN_NS + n * 10**9 + n, float(n)) for n in range(24)]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    return write_living_site(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def votes(small: SmallSite) -> dict[tuple[str, int], Any]:
    """Twenty cells of a camera and phase, of one class each."""
    names, grid = LabelSet.load().names, small.site.fuel_geometry(small.dem)
    rng = np.random.default_rng(5)
    found = {}
    for camera in CAMERAS:
        for phase in range(PHASES):
            cells = np.sort(rng.choice(grid.height * grid.width, 20, replace=False))
            rows, cols = (part.astype(np.int32) for part in np.divmod(cells, grid.width))
            counts = np.zeros((20, len(names)), np.uint32)
            counts[np.arange(20), rng.integers(1, 4, 20)] = rng.integers(5, 60, 20)
            one = CellVotes(grid, rows, cols, counts, np.zeros(20, np.float32), BEGIN_NS, camera)
            found[camera, phase] = votes_to_msg(one, names)
    return found


class Ran:
    """A fuel map that has counted frames and stopped; `told`: how often it told of each."""

    def __init__(
        self, small: SmallSite, votes: dict[tuple[str, int], Any], state: Path, frames: Sequence[Sent]
    ) -> None:
        outlet = Kept()
        node = FuelMapHandler(FuelMapConfig(site=str(small.path), folder=str(state)), outlet, Health())
        for frame in frames:
            message = votes[frame.camera, frame.phase]
            message.header.stamp = ns_to_time(frame.stamp_ns)
            node.on_votes(frame.camera, message)
            node.idle()
        node.finish()
        self.told = dict(Counter(outlet.stamps(FUEL_MAP_UPDATE)))
        self._judge = lambda told: judge(small, state, FRAMES, told, votes)

    def judged(self, **told: int) -> Verdict:
        return self._judge(self.told | {int(stamp[1:]): times for stamp, times in told.items()})


def test_a_good_run_holds(small: SmallSite, votes: dict[tuple[str, int], Any], tmp_path: Path) -> None:
    verdict = Ran(small, votes, tmp_path / "state", FRAMES[3:20]).judged()
    assert verdict.holds
    assert (verdict.sent, verdict.stored, verdict.told, verdict.untold) == (24, 17, 17, [])


def test_frames_that_are_lost_or_told_of_twice(
    small: SmallSite, votes: dict[tuple[str, int], Any], tmp_path: Path
) -> None:
    ran = Ran(small, votes, tmp_path / "state", FRAMES[:20])
    lost, twice = FRAMES[21].stamp_ns, FRAMES[2].stamp_ns
    assert ran.judged(**{f"s{lost}": 1}).lost == [lost]
    assert ran.judged(**{f"s{twice}": 2}).told_twice == [twice]
    assert ran.judged(s7=1).faults == ["told of 7 ns, which nobody sent"]


def test_a_frame_that_nobody_sent(small: SmallSite, votes: dict[tuple[str, int], Any], tmp_path: Path) -> None:
    forged = Sent("tower", 1, BEGIN_NS + 77, 0.0)
    verdict = Ran(small, votes, tmp_path / "state", [*FRAMES, forged]).judged()
    assert "25 frames in the store, 24 of them were sent" in verdict.faults
    assert any(fault.startswith("tile (0, 0)") for fault in verdict.faults)


def test_a_frame_of_other_content(small: SmallSite, votes: dict[tuple[str, int], Any], tmp_path: Path) -> None:
    """Counted once under its own stamp, and with what another frame shows."""
    other = Sent(FRAMES[4].camera, FRAMES[4].phase + 1, FRAMES[4].stamp_ns, 0.0)
    verdict = Ran(small, votes, tmp_path / "state", [*FRAMES[:4], other, *FRAMES[5:]]).judged()
    assert not verdict.lost
    assert any(fault.startswith("tile (0, 0)") for fault in verdict.faults)


def test_what_strangers_forge_is_no_vote_of_the_site(small: SmallSite) -> None:
    """Else the map would hold what nobody sent, and a run would fail for nothing."""
    names, grid = LabelSet.load().names, small.site.fuel_geometry(small.dem)
    near = [
        message
        for _, message in ATTACKS["forged votes"](Stranger("tower", random.Random(1)))
        if abs(message.header.stamp.sec - time.time()) < 60 and message.width
    ]
    assert near
    for message in near:
        with pytest.raises(MessageError):
            msg_to_votes(message, grid, names, "tower")
