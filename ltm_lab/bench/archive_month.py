"""Reprocess a simulated month in several ways, and measure what a sample of its frames costs the map."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from ltm_core.base.types import BoolArray, Int16Array
from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_lab.bench.archive import quiet
from ltm_lab.bench.simulated_month import Month, write_month
from ltm_ros.archive.reduction import store_digest
from ltm_ros.archive.run import ArchiveOptions, look_through, run
from ltm_ros.archive.sampling import Sample
from ltm_ros.archive.task import Engine, on_workers, serial
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline

SAMPLE = "4/day"
MOST_DIFFERENT = 0.001
"""Largest accepted share of the seen cells whose code differs in the map of the sample."""


@dataclass(frozen=True)
class MonthRun:
    """One way to the map. `cpu_s` is the processor time of this process, without workers."""

    name: str
    digest: str
    worked: int
    wall_s: float
    cpu_s: float


@dataclass(frozen=True)
class MonthResult:
    """A month's maps.

    `runs` are ways to the map without burns, which a replay does not know. The other figures are of the map with burns:
    `seen` cells, `different` cells whose code is another one by the sample, and the share of the seen felled cells that
    have changed, by all frames and by the sample. `page` shows the maps through time.
    """

    frames: int
    runs: tuple[MonthRun, ...]
    seen: int
    felled_changed: float
    sample_frames: int
    sample_rejected: dict[str, int]
    """Images that the sample did not take, by reason."""
    different: int
    sample_felled_changed: float
    page: str

    @property
    def holds(self) -> bool:
        """Return whether all runs have one digest and the sample differs in no more cells than accepted."""
        return len({one.digest for one in self.runs}) == 1 and self.different <= MOST_DIFFERENT * self.seen


def measure_month(folder: Path, days: int, say: Callable[[str], None], seed: int) -> MonthResult:
    """Draw the month of a seed in an empty `folder` and reprocess it."""
    month = write_month(folder, say, days, seed)
    options = ArchiveOptions(month.bags, month.site, folder / "all")
    runs = []
    for name, one, engine in (
        ("one process, a camera's day per task", options, serial),
        (
            "two processes, 10 frames per task",
            replace(options, out=folder / "two", frames_per_task=10),
            on_workers(2),
        ),
    ):
        say(name)
        runs.append(_reprocessed(name, one, engine))
    say("offline replay")
    runs.append(_replayed(month, folder / "replay"))
    say("with burns")
    options = replace(options, burns=month.burns)
    run(look_through(options, quiet), serial, quiet)
    codes, seen, changed = _codes(month, folder / "all" / STORE_FILE)
    say(f"a sample of {SAMPLE}")
    planned = look_through(replace(options, out=folder / "sample", sample=Sample.parsed(SAMPLE)), quiet)
    run(planned, serial, quiet)
    sampled, _, sample_changed = _codes(month, folder / "sample" / STORE_FILE)
    felled = month.felled & seen
    return MonthResult(
        month.frames,
        tuple(runs),
        int(seen.sum()),
        float(changed[felled].mean()),
        len(planned.frames),
        dict(planned.passed_over),
        int((codes != sampled)[seen].sum()),
        float(sample_changed[felled].mean()),
        str(folder / "all/maps/index.html"),
    )


def _reprocessed(name: str, options: ArchiveOptions, engine: Engine) -> MonthRun:
    begin, cpu = time.perf_counter(), time.process_time()
    found = run(look_through(options, quiet), engine, quiet)
    return MonthRun(name, found.digest, found.worked, time.perf_counter() - begin, time.process_time() - cpu)


def _replayed(month: Month, state: Path) -> MonthRun:
    state.mkdir()
    begin, cpu = time.perf_counter(), time.process_time()
    for bag in month.bags:
        run_offline(bag, month.site, ReplayOptions(state=state), quiet)
    spent = time.perf_counter() - begin, time.process_time() - cpu
    with TileStore.open_read_only(state / STORE_FILE, STORE_KIND) as store:
        return MonthRun("offline replay", store_digest(store), store.frame_count(), *spent)


def _codes(month: Month, store: Path) -> tuple[Int16Array, BoolArray, BoolArray]:
    """Return a store's codes, the cells with evidence or a burn, and the cells that differ from the prior map, on the
    grid of the month."""
    site = load_site(month.site)
    with FuelSource.open(store, site) as map_:
        layers, grid = map_.layers, map_.geometry
        touched = (layers.evidence > 0) | (layers.last_seen > 0)
    height, width = month.felled.shape
    top = round((grid.y_max - site.frame.y_origin - month.grid.y_max) / grid.resolution)
    left = round((month.grid.x_min - grid.x_min + site.frame.x_origin) / grid.resolution)
    part = slice(top, top + height), slice(left, left + width)
    return layers.code[part], touched[part], layers.changed[part]
