"""Run tasks of an archive, here or on processes: a camera's day each, from frames to votes to evidence.

A task writes a file named by the digest of its inputs. An existing file is valid, whoever wrote it."""

from __future__ import annotations

import multiprocessing
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa

from ltm_core.base.errors import ArchiveError, LtmError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.evidence_merge import PartialEvidence
from ltm_core.fuel.vote_columns import columns_to_votes, votes_to_columns
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep, TracingConfig, TracingStep, VotingStep, seen
from ltm_core.pipeline.site_fuel import empty_maps
from ltm_core.pipeline.stored_fuel import fuel_schema
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store_schema import Key
from ltm_ros.archive.files import write_result
from ltm_ros.archive.manifest import ArchiveFrame, ArchiveImageReader, Failure
from ltm_ros.archive.plan import Task, TaskSettings, code_digest, site_digest
from ltm_ros.archive.scan import packed, unpacked
from ltm_ros.runtime.health import cause_of
from ltm_ros.runtime.ros_environment import available_cores

_TILES = pa.schema(
    [("row", pa.int32()), ("col", pa.int32()), ("content", pa.binary()), ("stamps", pa.list_(pa.int64()))]
)


@dataclass(frozen=True)
class TaskReport:
    """Result of a task: number of frames whose images were read, 0 if its file existed."""

    worked: int


@dataclass(frozen=True, eq=False)
class TaskEvidence:
    """`touched`: tile -> stamps of its frames. `lost`: frames that failed; `unused`: reason -> number of images."""

    partial: PartialEvidence
    touched: dict[Key, list[int]]
    model: str
    lost: tuple[Failure, ...]
    unused: Mapping[str, int]


def work(task: Task, settings: TaskSettings) -> TaskReport:
    """Process the frames of a task, unless its file exists. Raises ArchiveError if the program, the site's files or an
    image have changed since the plan, OSError if files cannot be read or written now."""
    if code_digest() != settings.code:
        raise ArchiveError("the program has changed during the run; run again")
    file = settings.results / task.file
    if file.exists():
        return TaskReport(0)
    camera = task.frames[0].camera
    steps = _steps(settings.site, camera, settings.tracing, settings.labelling, task.site_key)
    write_result(file, _evidence_file(task, steps))
    return TaskReport(len(task.frames))


class FrameSteps:
    """All steps from an image to votes for one camera, in any order, so that smoke is not detected."""

    def __init__(self, site: Site, camera: str, tracing: TracingConfig, labelling: LabellingConfig) -> None:
        self.site = site
        self._tracing = TracingStep(site, camera, tracing)
        self._labelling = LabellingStep(site, camera, labelling)
        self._voting = VotingStep(site, camera)
        self.geometry = self._voting.geometry
        self.empty = empty_maps(site, self.geometry, self._voting.labels)
        """Makes a map without evidence."""

    @property
    def described(self) -> str:
        """Return the name and checksum of the label network."""
        return self._labelling.described

    def votes(self, frame: ArchiveFrame, photo: UInt8Array) -> tuple[CellVotes | None, str]:
        """Return the votes of a frame, None without any, and why it is not fully used. Raises LtmError."""
        camera, pose, stamp = frame.calibration, frame.pose, frame.stamp_ns
        posed = PosedImage(photo, camera, pose, stamp, frame.camera)
        found, view = self._labelling.label(posed, frame.covariance, in_order=False)
        if view.reason is not None:
            return None, view.unusable  # an image that shows nothing needs no ranges
        depth = seen(self._tracing.trace(camera, pose).ranges.depth(), self._tracing.hidden(camera, pose))
        cast = self._voting.cast(depth, camera, pose, found, stamp, frame.covariance)
        # As nodes receive them, through a message.
        names = self._voting.labels.names
        columns = votes_to_columns(self._voting.carried(cast), names)
        return columns_to_votes(columns, self.geometry, names, stamp, frame.camera), view.unusable


@lru_cache(maxsize=2)
def _steps(site: str, camera: str, tracing: TracingConfig, labelling: LabellingConfig, key: str) -> FrameSteps:
    found = load_site(site)
    if site_digest(found, camera, tracing, labelling) != key:
        raise ArchiveError(f"{site}, or a file that it names, has changed during the run; run again")
    return FrameSteps(found, camera, tracing, labelling)


def _evidence_file(task: Task, steps: FrameSteps) -> bytes:
    """Write one row per tile: its state, and the stamps of its frames."""
    evidence = steps.empty()
    for burn in task.burns:
        evidence.burn(burn.mask(steps.geometry.shape), burn.stamp_ns)
    touched: dict[Key, list[int]] = {}
    lost, unused, reader = [], Counter[str](), ArchiveImageReader()
    for frame in task.frames:
        picture = reader.read(frame)  # an image that cannot be read now must not count as a lost frame
        try:
            votes, reason = steps.votes(frame, picture.rgb())
        except LtmError as error:
            why = f"{error} ({frame.file}, stamp {frame.stamp_ns} ns)"
            lost.append(Failure("frame", cause_of(error), why))
            continue
        if reason:
            unused[reason] += 1
        window = None if votes is None else evidence.add(votes)
        for key in evidence.tiles_of(window) if window is not None else ():
            touched.setdefault(key, []).append(frame.stamp_ns)
    schema = fuel_schema(steps.site, steps.geometry)
    rows = [
        {"row": key[0], "col": key[1], "content": schema.pack(key, evidence.tile_state(key)), "stamps": stamps}
        for key, stamps in sorted(touched.items())
    ]
    about = {"camera": task.frames[0].camera, "model": steps.described, "unused": unused}
    return packed(pa.Table.from_pylist(rows, _TILES), about | {"lost": [asdict(one) for one in lost]})


def read_evidence(file: Path, site: Site, geometry: GridGeometry) -> TaskEvidence:
    """Read the result of a task; `geometry`: the fuel grid in the map frame. Raises ConfigError if it is corrupt."""
    (table, about), schema = unpacked(file), fuel_schema(site, geometry)
    tiles, touched = {}, {}
    for row in table.to_pylist():
        key = row["row"], row["col"]
        tiles[key], touched[key] = schema.unpack(row["content"]), row["stamps"]
    stamps = sorted({stamp for found in touched.values() for stamp in found})
    known = {about["camera"]: np.array(stamps, np.int64)} if stamps else {}
    lost = tuple(Failure(**one) for one in about["lost"])
    return TaskEvidence(PartialEvidence(known, tiles), touched, about["model"], lost, about["unused"])


_ATTEMPTS = 4
"""Number of workers that may die during a task before it is given up."""


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
    """Return an engine of `count` processes on this machine. `job`: replaces the work of each task."""

    def run(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
        own, workers = threading.local(), list[ProcessPoolExecutor]()  # each thread waits for a process of its own

        def ended(task: Task) -> Done:
            for _ in range(_ATTEMPTS):
                if not hasattr(own, "worker"):
                    context = multiprocessing.get_context("spawn")
                    own.worker = ProcessPoolExecutor(1, context, initializer=keep_to_cores, initargs=(count,))
                    workers.append(own.worker)
                try:
                    return Done(task, own.worker.submit(job or work, task, settings).result())
                except BrokenProcessPool:
                    del own.worker
                except (LtmError, OSError) as error:
                    return Done(task, None, str(error))
            why = "several workers died of it: out of memory, or an image that crashes the process"
            return Done(task, None, why)

        threads = ThreadPoolExecutor(min(count, len(tasks)))
        try:
            for future in as_completed([threads.submit(ended, task) for task in tasks]):
                yield future.result()
        finally:
            threads.shutdown(cancel_futures=True)
            for worker in workers:
                worker.shutdown()

    return run


def keep_to_cores(workers: int) -> None:
    """Limit a worker of this machine to its own cores, so that kernels do not wait for another worker's."""
    from ltm_core.base.kernels import limit_kernel_threads

    limit_kernel_threads(max(1, available_cores() // workers))
