"""Run tasks of an archive, here or on processes: a camera's day each, from frames to votes.

A task writes a file named by the digest of its inputs. An existing file is valid, whoever wrote it."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import pyarrow as pa

from ltm_core.base.errors import ArchiveError, LtmError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.vote_columns import columns_to_votes, votes_to_columns
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep, TracingConfig, TracingStep, VotingStep, seen
from ltm_core.pipeline.site_fuel import empty_maps
from ltm_core.pipeline.stored_fuel import votes_of, votes_to_bytes
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store_schema import FrameRecord
from ltm_ros.archive.files import write_result
from ltm_ros.archive.manifest import ArchiveFrame, ArchiveImageReader
from ltm_ros.archive.plan import Task, TaskSettings, code_digest, site_digest
from ltm_ros.archive.scan import packed, unpacked
from ltm_ros.runtime.health import cause_of
from ltm_ros.runtime.ros_environment import available_cores

_FRAMES = pa.schema([("stamp", pa.int64()), ("votes", pa.binary())])


@dataclass(frozen=True)
class TaskReport:
    """Result of a task: number of frames whose images were read, 0 if its file existed."""

    worked: int


@dataclass(frozen=True)
class LostFrame:
    """A frame without votes, and the reason."""

    camera: str
    stamp_ns: int
    cause: str
    why: str


@dataclass(frozen=True, eq=False)
class TaskResult:
    """`votes`: of each frame that shows something. `lost`: frames that failed; `unused`: reason -> number of frames
    with unusable images."""

    votes: tuple[CellVotes, ...]
    model: str
    lost: tuple[LostFrame, ...]
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
    write_result(file, _votes_file(task, steps))
    return TaskReport(len(task.frames))


class FrameSteps:
    """All steps from an image to votes for one camera; frames may come in any order, so smoke, which needs earlier
    images, is not detected."""

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
        """Return the votes of a frame, None if its image shows nothing, and why it is not fully used. Raises LtmError
        as the steps do."""
        camera, pose, stamp = frame.calibration, frame.pose, frame.stamp_ns
        posed = PosedImage(photo, camera, pose, stamp, frame.camera)
        found, view = self._labelling.label(posed, frame.pose_covariance, in_order=False)
        if view.reason is not None:
            return None, view.unusable  # an image that shows nothing needs no ranges
        depth = seen(self._tracing.trace(camera, pose).ranges.depth(), self._tracing.hidden(camera, pose))
        cast = self._voting.cast(depth, camera, pose, found, stamp, frame.pose_covariance)
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


def _votes_file(task: Task, steps: FrameSteps) -> bytes:
    """Write one row per frame with votes, losslessly."""
    rows, lost, unused, reader = [], [], Counter[str](), ArchiveImageReader()
    for frame in task.frames:
        picture = reader.read(frame)  # an image that cannot be read now must not count as a lost frame
        try:
            votes, reason = steps.votes(frame, picture.rgb())
        except LtmError as error:
            why = f"{error} ({frame.file}, stamp {frame.stamp_ns} ns)"
            lost.append(LostFrame(frame.camera, frame.stamp_ns, cause_of(error), why))
            continue
        if reason:
            unused[reason] += 1
        if votes is not None:
            rows.append({"stamp": frame.stamp_ns, "votes": votes_to_bytes(votes)})
    about = {"camera": task.frames[0].camera, "model": steps.described, "unused": unused}
    return packed(pa.Table.from_pylist(rows, _FRAMES), about | {"lost": [asdict(one) for one in lost]})


def read_result(file: Path, geometry: GridGeometry) -> TaskResult:
    """Read the result of a task; `geometry`: the fuel grid in the map frame. Raises ConfigError if it is corrupt."""
    table, about = unpacked(file)
    camera, model = about["camera"], about["model"]
    frames = [FrameRecord(camera, row["stamp"], (), model, row["votes"]) for row in table.to_pylist()]
    lost = tuple(LostFrame(**one) for one in about["lost"])
    return TaskResult(tuple(votes_of(frame, geometry) for frame in frames), model, lost, about["unused"])


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
