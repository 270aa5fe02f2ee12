"""Measures `ltm reprocess` on a simulated month: one map on all ways, and what a sample of its frames costs the map."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ltm_core.base.errors import ArchiveError
from ltm_core.base.types import BoolArray, Int16Array
from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_lab.bench.archive import Way
from ltm_lab.bench.archive_worker import EngineShare, engine_share
from ltm_lab.bench.simulated_month import DRAW, Month, write_month
from ltm_ros.archive.engine import Engine, on_workers, serial
from ltm_ros.archive.plan import evidence_name
from ltm_ros.archive.reduction import reduce_to_store, store_digest
from ltm_ros.archive.run import ArchiveOptions, Plan, look_through, run
from ltm_ros.archive.sampling import Sample
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline

SAMPLES = ("4/day", "8/day")
"""What is wanted holds of the first."""
WANTED = 0.001
"""Share of the seen cells, at most, whose code is another one by it."""


@dataclass(frozen=True)
class SampleCost:
    """What a sample costs the map: the frames that it takes, and why it did not take others; the cells whose code is
    another one by it, of those that all frames see; the share of the seen felled cells that have changed."""

    sample: str
    frames: int
    passed_over: dict[str, int]
    different: int
    felled_found: float

    def said(self, seen: int) -> str:
        """In words; `seen`: cells that all frames see."""
        return (
            f"{self.sample}: {self.frames} frames; {self.different} of {seen} seen cells have another code "
            f"({self.different / max(seen, 1):.3%}); {self.felled_found:.0%} of the felled cells have changed"
        )


@dataclass(frozen=True)
class LooksOfMonth:
    """What samples cost the map of month `draw`. `seen`, `felled_found` as of `MonthBench`."""

    draw: int
    seen: int
    felled_found: float
    samples: tuple[SampleCost, ...]


@dataclass(frozen=True)
class Resumed:
    """A run whose `tasks` are done: wall and processor seconds where its map is there too (`whole`), and where that was
    taken away and is made again, with its layers and page (`remade`)."""

    tasks: int
    whole_s: float
    whole_cpu_s: float
    remade_s: float
    remade_cpu_s: float


@dataclass(frozen=True)
class MonthBench:
    """`ways`: to the map without burns, which a replay is not told of; `burned_ways`: to that with them.

    `seen`: cells that all frames see; `felled_found`: share of the seen felled cells that have changed. `page`: the
    maps through time. `share`: of processor time that the engine takes where a task is a camera's day, as it is unless
    told otherwise; None: too few days.
    """

    frames: int
    ways: tuple[Way, ...]
    burned_ways: tuple[Way, ...]
    seen: int
    felled_found: float
    samples: tuple[SampleCost, ...]
    page: str
    resumed: Resumed | None = None
    share: EngineShare | None = None

    @property
    def holds(self) -> bool:
        """One digest of each, and no more codes than wanted another by the first sample."""
        one = all(len({way.digest for way in ways}) == 1 for ways in (self.ways, self.burned_ways))
        return one and self.samples[0].different <= WANTED * self.seen


def measure_month(folder: Path, days: int, said: Callable[[str], None], draw: int = DRAW) -> MonthBench:
    """In an empty `folder`; `draw`: which month."""
    month = write_month(folder, said, days, draw)
    options = ArchiveOptions(month.bags, month.site, str(folder / "all"))
    burned = replace(options, burns=month.burns)
    said("all frames, serial")
    ways = [_way("serial, a day a task", options, serial)]
    said("all frames, two workers")
    apart = replace(options, out=str(folder / "apart"), frames_per_task=10)
    ways.append(_way("2 workers, 10 frames a task", apart, on_workers(2)))
    said("the engine's share, a camera's day a task")
    daily = look_through(replace(options, out=str(folder / "daily")), _quiet)
    share = engine_share(daily.tasks, daily.settings) if len(daily.tasks) > 2 else None
    said("offline replay")
    ways.append(_replayed(month, folder / "replay"))
    said("burns")
    burned_ways = [
        _way("serial, a day a task, burns told", burned, serial),
        _way("serial, 10 frames a task, burns told", replace(apart, burns=month.burns), serial),
    ]
    looks = _looks(month, draw, Path(burned.out) / STORE_FILE, burned, SAMPLES, said)
    return MonthBench(
        month.frames,
        tuple(ways),
        tuple(burned_ways),
        looks.seen,
        looks.felled_found,
        looks.samples,
        str(folder / "all/maps/index.html"),
        resumed(options, folder / "single", said),
        share,
    )


def measure_looks(folder: Path, days: int, draw: int, said: Callable[[str], None]) -> LooksOfMonth:
    """What the first of the samples costs month `draw`'s map, and nothing else of it; in an empty `folder`.

    Raises ArchiveError where a task fails.
    """
    month = write_month(folder, said, days, draw)
    options = ArchiveOptions(month.bags, month.site, str(folder / "all"), burns=month.burns)
    said("all frames")
    every = folder / "all.ltm"
    _only_map(look_through(options, _quiet), every)
    return _looks(month, draw, every, options, SAMPLES[:1], said)


def _looks(
    month: Month,
    draw: int,
    every: Path,
    options: ArchiveOptions,
    samples: Sequence[str],
    said: Callable[[str], None],
) -> LooksOfMonth:
    """`every`: the store of all frames, which `options` work."""
    codes, seen, changed = _codes(month, every)
    felled, found = month.felled & seen, list[SampleCost]()
    for sample in samples:
        said(sample)
        out = every.parent / sample.replace("/", "_a_")
        planned = look_through(replace(options, out=str(out), sample=Sample.parsed(sample)), _quiet)
        _only_map(planned, out / STORE_FILE)
        others, _, also = _codes(month, out / STORE_FILE)
        different, share = int((codes != others)[seen].sum()), float(also[felled].mean())
        found.append(SampleCost(sample, len(planned.frames), dict(planned.passed_over), different, share))
    return LooksOfMonth(draw, int(seen.sum()), float(changed[felled].mean()), tuple(found))


def _only_map(planned: Plan, path: Path) -> None:
    """The store of a plan, without layers and page. Raises ArchiveError where a task fails."""
    for done in serial(planned.tasks, planned.settings):
        if done.report is None:
            raise ArchiveError(f"{done.task.label}: {done.error}")
    read = planned.results.read
    reduce_to_store(planned.tasks, lambda task: read(evidence_name(task)), planned.site, path, planned.burns)


def resumed(options: ArchiveOptions, out: Path, said: Callable[[str], None]) -> Resumed:
    """A run of which all is done, where each frame is a task of its own.

    Raises ArchiveError where a task is worked again, or the map that is made again is another one.
    """
    single = replace(options, out=str(out), frames_per_task=1)
    said("a frame a task, serial")
    done = run(look_through(single, _quiet), serial, _quiet)
    said(f"{done.tasks} done tasks again")
    whole = _way("all is there", single, serial)
    said("and without their map")
    (out / STORE_FILE).unlink()
    remade = _way("its map is made again", single, serial)
    for way in (whole, remade):
        if way.worked or way.digest != done.digest:
            raise ArchiveError(f"{way.name}: {way.worked} frames were worked again, digest {way.digest[:12]}")
    return Resumed(done.tasks, whole.wall_s, whole.cpu_s, remade.wall_s, remade.cpu_s)


def _way(name: str, options: ArchiveOptions, engine: Engine) -> Way:
    begin, cpu = time.perf_counter(), time.process_time()
    found = run(look_through(options, _quiet), engine, _quiet)
    return Way(name, found.digest, found.worked, time.perf_counter() - begin, time.process_time() - cpu)


def _replayed(month: Month, state: Path) -> Way:
    state.mkdir()
    begin, cpu = time.perf_counter(), time.process_time()
    for bag in month.bags:
        run_offline(bag, month.site, ReplayOptions(state=state), _quiet)
    spent = time.perf_counter() - begin, time.process_time() - cpu
    with TileStore.open_read_only(state / STORE_FILE, STORE_KIND) as store:
        return Way("offline replay", store_digest(store), store.frame_count(), *spent)


def _codes(month: Month, store: Path) -> tuple[Int16Array, BoolArray, BoolArray]:
    """Codes of a store's map, where there is evidence or it burned, and where it is not the prior's; on the world's
    grid."""
    with FuelSource.open(store, load_site(month.site)) as map_:
        layers = map_.layers
        touched = (layers.evidence > 0) | (layers.last_seen > 0)
        shape = month.felled.shape
        grid = map_.geometry
    site = load_site(month.site)
    top = round((grid.y_max - site.frame.y_origin - month.grid.y_max) / grid.resolution)
    left = round((month.grid.x_min - grid.x_min + site.frame.x_origin) / grid.resolution)
    part = slice(top, top + shape[0]), slice(left, left + shape[1])
    return layers.code[part], touched[part], layers.changed[part]


def _quiet(done: int, total: int) -> None:
    """Nobody watches."""
