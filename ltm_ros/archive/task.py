"""Run tasks of an archive, here or on processes: a camera's day each, from frames to votes.

A task writes a file named by the digest of its inputs. An existing file is valid, whoever wrote it."""

import multiprocessing
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import pyarrow as pa
import zstandard

from ltm_core.base.errors import ArchiveError, LtmError
from ltm_core.base.kernels import limit_kernel_threads
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.vote_columns import columns_to_votes, votes_to_columns
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep, TracingConfig, TracingStep, VotingStep, seen
from ltm_core.pipeline.stored_fuel import votes_of, votes_to_bytes
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store_schema import FrameRecord
from ltm_ros.archive.manifest import ArchiveFrame, ArchiveImageReader, Failure
from ltm_ros.archive.plan import Task, TaskSettings, code_digest, site_digest
from ltm_ros.archive.scan import packed, unpacked, write_result
from ltm_ros.runtime.health import cause_of
from ltm_ros.runtime.ros_environment import available_cores

_FRAMES = pa.schema([("stamp", pa.int64()), ("votes", pa.binary())])


def work(task: Task, settings: TaskSettings) -> int:
    """Process the frames of a task, unless its file exists; return the number of images read.

    Raises ArchiveError if the program, the site's files or an image have changed since the plan, OSError if files
    cannot be read or written now."""
    if code_digest() != settings.code:
        raise ArchiveError("the program has changed during the run; run again")
    file = settings.results / task.file
    if file.exists():
        return 0
    camera = task.frames[0].camera
    steps = _steps(settings.site, camera, settings.tracing, settings.labelling, task.site_key)
    write_result(file, _votes_file(task, steps))
    return len(task.frames)


class FrameSteps:
    """All steps from an image to votes for one camera, in any order, so that smoke is not detected."""

    def __init__(self, site: Site, camera: str, tracing: TracingConfig, labelling: LabellingConfig) -> None:
        self._tracing = TracingStep(site, camera, tracing)
        self._labelling = LabellingStep(site, camera, labelling)
        self._voting = VotingStep(site, camera)
        self.described = self._labelling.segmenter.described
        """Name and checksum of the label network."""

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
        return columns_to_votes(columns, self._voting.geometry, names, stamp, frame.camera), view.unusable


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
            lost.append(Failure("frame", cause_of(error), why))
            continue
        if reason:
            unused[reason] += 1
        if votes is not None:
            # At once, because a day's votes have gigabytes.
            rows.append({"stamp": frame.stamp_ns, "votes": zstandard.compress(votes_to_bytes(votes))})
    about = {"camera": task.frames[0].camera, "model": steps.described, "unused": unused}
    return packed(pa.Table.from_pylist(rows, _FRAMES), about | {"lost": [asdict(one) for one in lost]})


def read_result(
    file: Path, geometry: GridGeometry
) -> tuple[Iterator[CellVotes], str, list[Failure], Mapping[str, int]]:
    """Return the result of a task: votes of each frame that shows something, unpacked one by one, name of the network,
    frames that failed, and number of frames with unusable images by reason. `geometry`: the fuel grid in the map frame.
    Raises ConfigError if it is corrupt."""
    table, about = unpacked(file)
    camera, model, rows = about["camera"], about["model"], table.to_pylist()

    def votes(row: Mapping[str, Any]) -> CellVotes:
        return votes_of(FrameRecord(camera, row["stamp"], (), model, zstandard.decompress(row["votes"])), geometry)

    return map(votes, rows), model, [Failure(**one) for one in about["lost"]], about["unused"]


_ATTEMPTS = 4
"""Number of workers that may die during a task before it is given up."""


@dataclass(frozen=True)
class Done:
    """A finished task; `worked`: number of images read; `error`: why it gave no result."""

    task: Task
    worked: int
    error: str = ""


Job = Callable[[Task, TaskSettings], int]
Engine = Callable[[Sequence[Task], TaskSettings], Iterator[Done]]


def serial(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
    """Run one task after the other in this process."""
    for task in tasks:
        try:
            yield Done(task, work(task, settings))
        except (LtmError, OSError) as error:
            yield Done(task, 0, str(error))


def on_workers(count: int, job: Job | None = None) -> Engine:
    """Return an engine of `count` processes on this machine. `job`: replaces the work of each task."""

    def run(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
        own, workers = threading.local(), list[ProcessPoolExecutor]()  # each thread waits for a process of its own
        cores = available_cores()  # for all workers together, so that kernels do not wait for another worker's

        def ended(task: Task) -> Done:
            for _ in range(_ATTEMPTS):
                if not hasattr(own, "worker"):
                    context = multiprocessing.get_context("spawn")
                    own.worker = ProcessPoolExecutor(1, context, limit_kernel_threads, (max(1, cores // count),))
                    workers.append(own.worker)
                try:
                    return Done(task, own.worker.submit(job or work, task, settings).result())
                except BrokenProcessPool:
                    del own.worker
                except (LtmError, OSError) as error:
                    return Done(task, 0, str(error))
                except KeyboardInterrupt:  # Ctrl-C interrupts the workers, too; else this thread would begin a task
                    threads.shutdown(wait=False, cancel_futures=True)
                    raise
            why = "several workers died of it: out of memory, or an image that crashes the process"
            return Done(task, 0, why)

        threads = ThreadPoolExecutor(min(count, len(tasks)))
        try:
            for future in as_completed([threads.submit(ended, task) for task in tasks]):
                yield future.result()
        finally:
            threads.shutdown(cancel_futures=True)
            for worker in workers:
                worker.shutdown()

    return run
