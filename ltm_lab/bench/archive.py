"""Measures `ltm reprocess` on a recording: that all ways give one map, and what a frame costs on each."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import psutil

from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.storage.tile_store import TileStore
from ltm_lab.bench.archive_kills import run_under_kills
from ltm_lab.bench.archive_worker import (
    EngineCost,
    EngineShare,
    WorkerCost,
    engine_cost,
    engine_share,
    worker_cost,
)
from ltm_lab.bench.measure import peak_mb
from ltm_ros.archive.engine import Engine, on_workers, serial
from ltm_ros.archive.node_rules import node_rules
from ltm_ros.archive.plan import VOTES, plan
from ltm_ros.archive.reduction import store_digest
from ltm_ros.archive.run import ArchiveOptions, look_through, run
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline


@dataclass(frozen=True)
class Way:
    """One way to the map. `cpu_s`: of this process, so not of workers'. `kills`: workers ended with SIGKILL."""

    name: str
    digest: str
    worked: int
    wall_s: float
    cpu_s: float
    kills: int = 0


@dataclass(frozen=True)
class ArchiveBench:
    """`votes_bytes`: of a frame, in files of `frames_per_file` at most. `peak_mb`: of the process that worked alone,
    map and layers included. `worker`: of tasks alone; `shares`: what of processor time the engine takes, by
    the size of tasks; `engine`: of empty tasks, None where none was asked for."""

    frames: int
    ways: tuple[Way, ...]
    votes_bytes: float
    frames_per_file: int
    peak_mb: float
    worker: WorkerCost
    shares: tuple[EngineShare, ...]
    engine: EngineCost | None

    @property
    def digests(self) -> set[str]:
        return {way.digest for way in self.ways}


def measure(
    bag: Path,
    site: Path,
    folder: Path,
    kills: int,
    empty: int,
    seed: int,
    said: Callable[[str], None],
    everything: int = 0,
) -> ArchiveBench:
    """In an empty `folder`. `kills`: runs on two workers in which one of them is killed at a random moment. `empty`:
    tasks that do nothing, for the engine's own cost; 0: it is not measured. `everything`: workers and whole commands,
    their scheduler included, that are killed on the way to one more map."""
    options = ArchiveOptions((bag,), site, str(folder / "warm"), frames_per_task=1)
    planned = look_through(options, _quiet)
    said("kernels and networks")
    run(replace(planned, tasks=planned.tasks[:1]), serial, _quiet)
    ways = []
    for name, per_task, engine in (
        ("serial, a day a task", 1500, serial),
        ("serial, a frame a task", 1, serial),
        ("1 worker, 5 frames a task", 5, on_workers(1)),
        ("2 workers, 5 frames a task", 5, on_workers(2)),
    ):
        said(name)
        place = replace(options, out=str(folder / name.replace(" ", "_")), frames_per_task=per_task)
        ways.append(_timed(name, place, engine))
        if not ways[1:]:
            peak, sizes = peak_mb(), [file.stat().st_size for file in (Path(place.out) / VOTES).iterdir()]
            ways.append(_timed("the same again", place, engine))
    chance = random.Random(seed)  # nosec B311 # moments to kill at, no secret
    for number in range(kills):
        name = f"2 workers, one killed ({number + 1})"
        said(name)
        ways.append(_killed(name, replace(options, out=str(folder / f"killed_{number}")), chance))
    if everything:
        said(f"{everything} kills of workers and of the command")
        begin, out = time.perf_counter(), folder / "killed_all"
        workers, commands = run_under_kills(bag, site, out, everything, chance)
        last = _timed("", replace(options, out=str(out)), serial)
        name = f"2 workers, {commands} times the scheduler killed too"
        ways.append(replace(last, name=name, wall_s=time.perf_counter() - begin, kills=workers + commands))
    said("offline replay")
    state = folder / "replay"
    state.mkdir()
    begin, cpu = time.perf_counter(), time.process_time()
    run_offline(bag, site, ReplayOptions(state=state), _quiet)
    spent = time.perf_counter() - begin, time.process_time() - cpu
    with TileStore.open_read_only(state / STORE_FILE, STORE_KIND) as store:
        frames = store.frame_count()
        ways.append(Way("offline replay, with fused depth where the site has it", store_digest(store), frames, *spent))
    said("a worker alone")
    alone = look_through(replace(options, out=str(folder / "alone"), frames_per_task=1500), _quiet)
    fusing = node_rules(planned.site, site, planned.frames[0].camera).fusing
    settings = replace(alone.settings, fusing=fusing)
    measured = plan(alone.frames, alone.site, settings, 1500) if fusing is not None else ()
    worker = worker_cost(alone.tasks, settings, measured)
    said("the engine's share")
    shares = []
    for per_task in (1, 4):
        shared = replace(options, out=str(folder / f"share_{per_task}"), frames_per_task=per_task)
        found = look_through(shared, _quiet)
        if len(found.tasks) > 2:
            shares.append(engine_share(found.tasks, found.settings))
    if empty:
        said(f"{empty} empty tasks")
    engine_alone = engine_cost(empty, alone.settings) if empty else None
    each = sum(sizes) / len(planned.frames)
    return ArchiveBench(len(planned.frames), tuple(ways), each, 1500, peak, worker, tuple(shares), engine_alone)


def _timed(name: str, options: ArchiveOptions, engine: Engine) -> Way:
    begin, cpu = time.perf_counter(), time.process_time()
    found = run(look_through(options, _quiet), engine, _quiet)
    return Way(name, found.digest, found.worked, time.perf_counter() - begin, time.process_time() - cpu)


def _killed(name: str, options: ArchiveOptions, chance: random.Random) -> Way:
    planned = look_through(options, _quiet)
    moment, killed = chance.randrange(len(planned.tasks)), list[int]()

    def kill(done: int, total: int) -> None:
        if done >= moment and not killed:
            workers = [p for p in psutil.Process().children(recursive=True) if "spawn_main" in str(p.cmdline())]
            if workers:
                victim = chance.choice(workers)
                victim.kill()
                killed.append(victim.pid)

    begin, cpu = time.perf_counter(), time.process_time()
    found = run(planned, on_workers(2), kill)
    spent = time.perf_counter() - begin, time.process_time() - cpu
    return Way(name, found.digest, found.worked, *spent, len(killed))


def _quiet(done: int, total: int) -> None:
    """Nobody watches."""
