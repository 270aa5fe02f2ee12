"""`ltm-lab bench region`: towers whose link was down, a broker and a region's map, killed at random.

Whether the map then is, to the bit, the one of all frames, and how fast it caught up.
"""

from __future__ import annotations

import random
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from ltm_core.fuel.surface_change import LivingFuelMap
from ltm_core.uplink.config import AGGREGATOR
from ltm_lab.bench.network_site import Traffic, write_region
from ltm_lab.bench.region_tower import CAMERA
from ltm_lab.bench.region_trial import RegionTrial
from ltm_ros.region.certs import BROKER

DOWN_S: Final = (0.1, 1.5)
"""For which a killed process stays away."""


@dataclass(frozen=True)
class RegionResult:
    """One run. `frames`: sent by all towers; `stored`: counted in the map, each once; `equal`: the map is, to the bit,
    that of all frames. `catch_up_s`: from the link's return until every outbox was empty.
    """

    frames: int
    stored: int
    equal: bool
    kills: dict[str, int]
    catch_up_s: float
    times_real: float
    """Seconds of votes a second, by the clock."""
    cpu_ms_a_frame: dict[str, float]
    """Processor time while it caught up: of all `towers` together, of the `broker`, of the `map`; empty: some were
    killed meanwhile."""
    times_real_on_cores: float | None
    """Seconds of votes a second of processor time of the process that used most: as where each has a core of its own,
    and none waits for another."""
    dropped: dict[str, int]
    bytes_a_frame: float


@dataclass
class Killer:
    """Kills one of several processes, again and again, and starts it anew a moment later."""

    trial: RegionTrial
    names: list[str]
    random: random.Random
    kills: Counter[str] = field(default_factory=Counter)

    def kill_while_answered(self, kills: int) -> None:
        """Spread over the whole of the catching up: each after one more of as many parts of the frames."""
        for number in range(kills):
            self.trial.wait("more frames are answered for", partial(self._answered, number / (kills + 1)))
            self.kill(1.0)

    def _answered(self, share: float) -> bool:
        return self.trial.answered() >= share

    def kill(self, at_most_s: float) -> None:
        time.sleep(self.random.uniform(0, at_most_s))
        name = self.random.choice(self.names)
        self.trial.kill(name)
        self.kills[name if name in (BROKER, AGGREGATOR) else "towers"] += 1
        time.sleep(self.random.uniform(*DOWN_S))
        self.trial.start(name)


def run_region(
    folder: Path, traffic: Traffic, seconds: int, kills: int, seed: int, say: Callable[[str], None]
) -> RegionResult:
    """Fill the outboxes while the link is down, then let it return; a third of the kills fall into the first part.

    Raises LtmError where the run does not come to its end.
    """
    draws = random.Random(seed)  # nosec B311 # no secret
    with RegionTrial(folder, traffic, seconds) as trial:
        for name in [*trial.towers, AGGREGATOR]:
            trial.start(name)
        killer = Killer(trial, [*trial.towers, AGGREGATOR], draws)
        for _ in range(kills // 3):
            killer.kill(1.0)
        trial.wait("the outboxes have all frames", lambda: trial.all_kept() and trial.map_answers)
        say(f"link down: {trial.frames} frames in {len(trial.towers)} outboxes")
        begun, before = time.monotonic(), {name: trial.cpu_s(name) for name in [*trial.towers, AGGREGATOR]}
        trial.start(BROKER)
        killer.names = [BROKER, BROKER, AGGREGATOR, AGGREGATOR, *trial.towers]
        killer.kill_while_answered(kills - kills // 3)
        trial.wait("the outboxes are empty", trial.all_sent)
        took = time.monotonic() - begun
        say(f"caught up after {took:.1f} s with {sum(killer.kills.values())} kills")
        used = {name: trial.cpu_s(name) - before.get(name, 0.0) for name in [BROKER, *before]}
        parts = {"towers": sum(used[name] for name in trial.towers), "broker": used[BROKER], "map": used[AGGREGATOR]}
        trial.kill(AGGREGATOR)
        found, sources = trial.found()
        dropped = Counter[str]()
        for said in trial.said.values():
            dropped.update(said["dropped"])
        expected = {f"{name}_{CAMERA}": seconds for name in trial.towers}
        return RegionResult(
            frames=trial.frames,
            stored=sum(sources.values()),
            equal=sources == expected and same_map(found, trial.expected()),
            kills=dict(killer.kills),
            catch_up_s=took,
            times_real=seconds / took,
            cpu_ms_a_frame={} if kills else {part: 1000 * cpu_s / trial.frames for part, cpu_s in parts.items()},
            times_real_on_cores=None if kills else seconds / max(used.values()),
            dropped=dict(dropped),
            bytes_a_frame=traffic.bytes,
        )


def same_map(one: LivingFuelMap, other: LivingFuelMap) -> bool:
    """Whether every bit of the state of all cells is the same, and the time that the maps tell."""
    rows, cols = one.tiles
    for key in [(row, col) for row in range(rows) for col in range(cols)]:
        mine, theirs = one.tile_state(key), other.tile_state(key)
        if any(not np.array_equal(mine[name], theirs[name]) for name in mine):
            return False
    return one.newest_ns == other.newest_ns


def run_bench(
    towers: int,
    seconds: int,
    kills: int,
    seed: int,
    extent: float,
    views: int,
    say: Callable[[str], None],
    calm: bool = True,
) -> dict[str, RegionResult]:
    """`calm`: a run without kills, which tells how fast the map catches up; `killed`, unless there are none: with.

    Of both or one of them; of neither where there are no kills and `calm` is False.
    """
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as name:
        folder = Path(name)
        for part in ("traffic", "calm", "killed"):
            (folder / part).mkdir()
        traffic = write_region(folder / "traffic", towers, extent, views)
        results = {"calm": run_region(folder / "calm", traffic, seconds, 0, seed, say)} if calm else {}
        if kills:
            results["killed"] = run_region(folder / "killed", traffic, seconds, kills, seed, say)
        return results
