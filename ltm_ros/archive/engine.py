"""Run tasks one after the other, or on processes of this machine.

Both give the same files; the worker, time and number of attempts of a task have no effect.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

from ltm_core.base.errors import LtmError
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.task import TaskReport, work
from ltm_ros.runtime.ros_environment import available_cores

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
    of each task.
    """

    def run(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
        workers = [_worker(count) for _ in range(min(count, len(tasks)))]
        ahead, deaths = iter(tasks), dict[int, int]()
        at_work: dict[Future[TaskReport], tuple[int, Task]] = {}

        def start(number: int, task: Task | None) -> None:
            if task is not None:
                at_work[workers[number].submit(job or work, task, settings)] = number, task

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
