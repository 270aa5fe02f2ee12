"""Run tasks of an archive, here or on processes: a camera's day each, from frames to votes to evidence.

Each step writes a file named by the digest of its inputs. An existing file is valid, whoever wrote it; its step is not
repeated."""

from __future__ import annotations

import io
import json
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ltm_core.base.errors import ArchiveError, LtmError
from ltm_core.base.resources import config_path
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.evidence_merge import PartialEvidence
from ltm_core.fuel.overlays_io import Burn
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_fuel import empty_maps
from ltm_core.pipeline.stored_fuel import fuel_schema
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store_schema import Key
from ltm_core.vision.labels import LabelSet
from ltm_ros.archive.content_digest import code_digest, evidence_digest
from ltm_ros.archive.files import ResultFolder
from ltm_ros.archive.frame_files import ABOUT, LostFrame, frame_files, packed_table, read_packed, read_votes
from ltm_ros.archive.plan import (
    MEASURED,
    VOTES,
    Task,
    TaskSettings,
    evidence_key,
    evidence_name,
    measured_name,
    other_files,
    votes_name,
)
from ltm_ros.runtime.ros_environment import available_cores

_TILES = pa.schema(
    [("row", pa.int32()), ("col", pa.int32()), ("content", pa.binary()), ("stamps", pa.list_(pa.int64()))]
)


@dataclass(frozen=True)
class TaskReport:
    """Result of a task: number of frames whose images were read, 0 if all files existed."""

    worked: int


@dataclass(frozen=True, eq=False)
class TaskEvidence:
    """`touched`: tile -> stamps of its frames. `lost`: frames that failed; `unused`: reason -> number of frames with
    unusable images."""

    partial: PartialEvidence
    touched: dict[Key, list[int]]
    model: str
    lost: tuple[LostFrame, ...]
    unused: dict[str, int]


def work(task: Task, settings: TaskSettings) -> TaskReport:
    """Run the missing steps. Raises ArchiveError if the program or the site's files have changed since the plan,
    OSError if results cannot be read or written now."""
    if code_digest() != settings.code:
        raise ArchiveError("the program has changed during the run; run again")
    results = ResultFolder(settings.results)
    votes, evidence = votes_name(task), evidence_name(task)
    done = results.has(evidence)
    wanted = [] if done or results.has(votes) else [VOTES]
    wanted += [MEASURED] if task.measured_key and not results.has(measured_name(task)) else []
    worked = 0
    if wanted:
        made, names = frame_files(task, settings, wanted), {VOTES: votes, MEASURED: measured_name(task)}
        for kind in wanted:
            results.write(names[kind], made[kind])
        worked = len(task.frames)
    if done:
        return TaskReport(worked)
    of_evidence = evidence_digest(load_site(settings.site))
    if evidence_key(settings, task.votes_key, of_evidence, task.burns) != task.evidence_key:
        raise other_files(settings.site)
    results.write(evidence, _evidence_file(results.read(votes), _ground(settings.site, of_evidence), task.burns))
    return TaskReport(worked)


@dataclass(frozen=True, eq=False)
class _Ground:
    """The basis of evidence, the same for all tasks of a run. `empty` makes maps without evidence."""

    site: Site
    labels: LabelSet
    geometry: GridGeometry
    empty: Callable[[], EvidenceMap]


@lru_cache(maxsize=1)
def _ground(site: str, of_evidence: str) -> _Ground:
    """Load the basis. `of_evidence`: digest of its files now."""
    found = load_site(site)
    labels, geometry = LabelSet.load(config_path(found.labels)), found.fuel_geometry(found.open_dem())
    return _Ground(found, labels, geometry, empty_maps(found, geometry, labels))


def _evidence_file(votes: bytes, ground: _Ground, burns: Sequence[Burn]) -> bytes:
    """Write one row per tile: its state, and the stamps of its frames."""
    labels, geometry, evidence = ground.labels, ground.geometry, ground.empty()
    for burn in burns:
        evidence.burn(burn.mask(geometry.shape), burn.stamp_ns)
    touched: dict[Key, list[int]] = {}
    for found in read_votes(votes, geometry, labels):
        window = evidence.add(found)
        for key in evidence.tiles_of(window) if window is not None else ():
            touched.setdefault(key, []).append(found.stamp_ns)
    about = json.loads(pq.read_schema(io.BytesIO(votes)).metadata[ABOUT.encode()])
    unused: dict[str, int] = {}
    for frame in about.pop("frames"):
        if frame["reason"]:
            unused[frame["reason"]] = unused.get(frame["reason"], 0) + 1
    schema = fuel_schema(ground.site, geometry)
    rows = [
        {"row": key[0], "col": key[1], "content": schema.pack(key, evidence.tile_state(key)), "stamps": stamps}
        for key, stamps in sorted(touched.items())
    ]
    return packed_table(pa.Table.from_pylist(rows, _TILES), about | {"unused": unused})


def read_evidence(content: bytes, site: Site, geometry: GridGeometry) -> TaskEvidence:
    """Read the evidence file of a task; `geometry`: the fuel grid in the map frame. Raises ConfigError if it is
    corrupt."""
    table, schema = read_packed(content), fuel_schema(site, geometry)
    about = json.loads(table.schema.metadata[ABOUT.encode()])
    tiles, touched = {}, {}
    for row in table.to_pylist():
        key = row["row"], row["col"]
        tiles[key], touched[key] = schema.unpack(row["content"]), row["stamps"]
    stamps = sorted({stamp for found in touched.values() for stamp in found})
    known = {about["camera"]: np.array(stamps, np.int64)} if stamps else {}
    lost = tuple(LostFrame(**one) for one in about["lost"])
    return TaskEvidence(PartialEvidence(known, tiles), touched, about["model"], lost, about["unused"])


_DEATHS = 3
"""Number of workers, beyond the first, that may die during a task before it is given up."""


@dataclass(frozen=True)
class Done:
    """A finished task; `error`: why it gave no result."""

    task: Task
    report: TaskReport | None
    error: str = ""


Job = Callable[[Task, TaskSettings], TaskReport]
Engine = Callable[[Sequence[Task], TaskSettings], Iterator[Done]]


def serial(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
    """Run one task after the other in this process."""
    for task in tasks:
        try:
            yield Done(task, work(task, settings))
        except (LtmError, OSError) as error:
            yield Done(task, None, str(error))


def on_workers(count: int, job: Job | None = None) -> Engine:
    """Return an engine with the given number of processes on this machine, which end with it. `job`: replaces the work
    of each task."""

    def run(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
        workers = [_worker(count) for _ in range(min(count, len(tasks)))]
        ahead, deaths = iter(tasks), dict[int, int]()
        at_work: dict[Future[TaskReport], tuple[int, Task]] = {}

        def start(number: int, task: Task | None) -> None:
            if task is not None:
                try:
                    at_work[workers[number].submit(job or work, task, settings)] = number, task
                except BrokenProcessPool:  # it died after its last task
                    workers[number] = _worker(count)
                    start(number, task)

        try:
            for number in range(len(workers)):
                start(number, next(ahead, None))
            while at_work:
                for future in wait(at_work, return_when=FIRST_COMPLETED).done:
                    number, task = at_work.pop(future)
                    error = future.exception()
                    if isinstance(error, BrokenProcessPool):  # each worker has one task, so that it is this one's
                        workers[number].shutdown()
                        workers[number] = _worker(count)
                        deaths[number] = deaths.get(number, 0) + 1
                        if deaths[number] <= _DEATHS:
                            start(number, task)
                            continue
                        why = "several workers died of it: out of memory, or an image that crashes the process"
                        yield Done(task, None, why)
                    elif error is None:
                        yield Done(task, future.result())
                    elif isinstance(error, LtmError | OSError):
                        yield Done(task, None, str(error))
                    else:
                        raise error  # an internal error
                    deaths[number] = 0
                    start(number, next(ahead, None))
        finally:
            for worker in workers:
                worker.shutdown(cancel_futures=True)

    return run


def _worker(count: int) -> ProcessPoolExecutor:
    """Return an executor of one process, which is limited to its share of the cores."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, context, initializer=keep_to_cores, initargs=(count,))


def keep_to_cores(workers: int) -> None:
    """Limit a worker of this machine to its own cores, so that kernels do not wait for another worker's."""
    from ltm_core.base.kernels import limit_kernel_threads

    limit_kernel_threads(max(1, available_cores() // workers))
