"""What a worker of an archive does and holds, measured in a process that does nothing else."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

from ltm_core.bench.measure import peak_mb, resident_mb
from ltm_ros.archive.engine import on_workers
from ltm_ros.archive.frame_files import votes_file
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.task import TaskReport, work


@dataclass(frozen=True)
class WorkerCost:
    """CPU seconds a frame `to_votes`, and of `tasks` as a whole, with evidence and files, kernels and networks being
    there; the most memory held."""

    to_votes_s: float
    tasks_s: float
    peak_mb: float


@dataclass(frozen=True)
class EngineCost:
    """Of empty tasks: CPU milliseconds each of scheduler and client, and what their process held when a tenth and when
    all had ended."""

    tasks: int
    each_ms: float
    early_mb: float
    late_mb: float


def worker_cost(tasks: Sequence[Task], settings: TaskSettings) -> WorkerCost:
    """Of tasks whose results are not there yet, in a fresh process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_worked, tasks, settings).result()


def _worked(tasks: Sequence[Task], settings: TaskSettings) -> WorkerCost:
    frames = sum(len(task.frames) for task in tasks)
    for task in tasks:
        votes_file(Task(task.frames[:1], task.steps_key, "", ""), settings)
    begin = time.process_time()
    for task in tasks:
        votes_file(task, settings)
    to_votes = time.process_time()
    for task in tasks:
        work(task, settings)
    return WorkerCost((to_votes - begin) / frames, (time.process_time() - to_votes) / frames, peak_mb())


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
