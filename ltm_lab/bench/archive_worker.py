"""What a worker of an archive does and holds, measured in a process that does nothing else."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context

from ltm_lab.bench.measure import peak_mb, resident_mb
from ltm_ros.archive.engine import keep_to_cores, on_workers
from ltm_ros.archive.frame_files import frame_files, votes_file
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.plan import MEASURED, VOTES, Task, TaskSettings
from ltm_ros.archive.task import TaskReport, work


@dataclass(frozen=True)
class WorkerCost:
    """CPU seconds a frame `to_votes`, `to_measured`, which is votes and what the terrain takes in one pass (None: the
    site has no depth network), and of `tasks` as a whole, with evidence and files, kernels and networks being there;
    the most memory held up to votes and evidence, and at all; bytes of what was measured of a frame."""

    to_votes_s: float
    tasks_s: float
    peak_mb: float
    to_measured_s: float | None = None
    fusing_peak_mb: float | None = None
    measured_bytes: float | None = None


@dataclass(frozen=True)
class EngineCost:
    """Of empty tasks: CPU milliseconds each of scheduler and client, and what their process held when a tenth and when
    all had ended."""

    tasks: int
    each_ms: float
    early_mb: float
    late_mb: float


@dataclass(frozen=True)
class EngineShare:
    """Of processor time from the first task's end to the last's: that of tasks in their workers, and of scheduler and
    client, whose process is this one. `frames`: of a task, at most."""

    frames: int
    tasks: int
    tasks_s: float
    engine_s: float

    @property
    def share(self) -> float:
        return self.engine_s / (self.engine_s + self.tasks_s)

    @property
    def said(self) -> str:
        """In words."""
        return (
            f"engine: {self.share:.2%} of the processor time of {self.tasks} tasks of up to {self.frames} frames on "
            f"two workers, {self.each_ms:.0f} ms each"
        )

    @property
    def each_ms(self) -> float:
        """Of scheduler and client, a task."""
        return 1e3 * self.engine_s / self.tasks


def worker_cost(tasks: Sequence[Task], settings: TaskSettings, measured: Sequence[Task] = ()) -> WorkerCost:
    """Of tasks whose results are not there yet, in a fresh process with the threads of one of two workers. `measured`:
    the same of a plan that measures, with its settings' `fusing`; none: the site has no depth network."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_worked, tasks, settings, measured).result()


def _worked(tasks: Sequence[Task], settings: TaskSettings, measured: Sequence[Task]) -> WorkerCost:
    keep_to_cores(2)
    frames = sum(len(task.frames) for task in tasks)
    for task in tasks:
        votes_file(Task(task.frames[:1], task.steps_key, "", ""), settings)
    begin = time.process_time()
    for task in tasks:
        votes_file(task, settings)
    to_votes = time.process_time()
    for task in tasks:
        work(task, settings)
    worked = time.process_time()
    found = WorkerCost((to_votes - begin) / frames, (worked - to_votes) / frames, peak_mb())
    if not measured:
        return found
    both = VOTES, MEASURED
    for task in measured:
        frame_files(replace(task, frames=task.frames[:1]), settings, both)
    begin = time.process_time()
    sizes = [len(frame_files(task, settings, both)[MEASURED]) for task in measured]
    spent = (time.process_time() - begin) / frames
    return replace(found, to_measured_s=spent, fusing_peak_mb=peak_mb(), measured_bytes=sum(sizes) / frames)


@dataclass(frozen=True)
class TimedReport(TaskReport):
    """`cpu_s`: processor time of the worker meanwhile."""

    cpu_s: float


def engine_share(tasks: Sequence[Task], settings: TaskSettings) -> EngineShare:
    """Of tasks, at least three, whose results are not there yet, on two processes."""
    spent, begin, end = 0.0, 0.0, 0.0
    for number, ended in enumerate(on_workers(2, timed_work)(tasks, settings)):
        end = time.process_time()  # of the last: workers are not yet let go
        if number == 0:
            begin = end
        elif isinstance(ended.report, TimedReport):
            spent += ended.report.cpu_s
    return EngineShare(max(len(task.frames) for task in tasks), len(tasks) - 1, spent, end - begin)


def timed_work(task: Task, settings: TaskSettings) -> TaskReport:
    """A task, and the processor time of its worker meanwhile, other threads included."""
    begin = time.process_time()
    return TimedReport(work(task, settings).worked, time.process_time() - begin)


def engine_cost(count: int, settings: TaskSettings) -> EngineCost:
    """Of so many tasks that do nothing, on two processes; the scheduler is in this one."""
    frame = ArchiveFrame("none", 0, "", "", 0, 0, "", (), (), (), ())
    tasks = [Task((frame,), "", "", f"{number}") for number in range(count)]
    held = list[float]()
    begin = time.process_time()
    for number, _ in enumerate(on_workers(2, nothing)(tasks, settings), start=1):
        if number in (count // 10, count):
            held.append(resident_mb())
    return EngineCost(count, (time.process_time() - begin) / count * 1e3, held[0], held[-1])


def nothing(task: Task, settings: TaskSettings) -> TaskReport:
    """A task that does nothing."""
    return TaskReport(0)
