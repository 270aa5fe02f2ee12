"""Measure how much faster two processes reprocess an archive than one, after kernels and networks are loaded."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.writer import CompressionType

from ltm_core.base.errors import ArchiveError
from ltm_core.base.number_text import DAY_NS
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.stamp import ns_to_time, stamp_of
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.run import ArchiveOptions, Plan, look_through
from ltm_ros.archive.task import Engine, on_workers, serial, work

_WARM_UP = 2
"""Tasks of each process that are not counted; the first loads kernels and networks."""


@dataclass(frozen=True)
class Speedup:
    """Frames per second of one process and of two, for `tasks` tasks of up to `frames` frames each."""

    tasks: int
    frames: int
    alone_hz: float
    together_hz: float
    alone_cpu_s: float
    """Processor time per frame of one process."""
    engine_share: float
    """Share of scheduler and client in the processor time of the two processes."""

    @property
    def times(self) -> float:
        """Frames per second of two processes over those of one."""
        return self.together_hz / self.alone_hz


def measure_speedup(bag: Path, site: Path, folder: Path, days: int, say: Callable[[str], None]) -> Speedup:
    """Measure a recording that is repeated on `days` days, in an empty `folder`. Raises ArchiveError for few days."""
    say(f"writing {days} days")
    days_bag = write_days(bag, folder / "days", days)
    options = ArchiveOptions((days_bag,), site, folder / "serial")
    planned = look_through(options, quiet)
    if len(planned.tasks) < 4 * _WARM_UP + 2:
        raise ArchiveError(f"{days} days make {len(planned.tasks)} tasks, too few for two processes; give more days")
    say(f"{len(planned.tasks)} tasks, one process")
    alone = WorkedPlan(planned, serial)
    say("two processes")
    both = WorkedPlan(look_through(replace(options, out=folder / "apart"), quiet), on_workers(2, timed_work))
    return Speedup(
        len(planned.tasks),
        max(len(task.frames) for task in planned.tasks),
        alone.rate(_WARM_UP, 0),
        both.rate(2 * _WARM_UP, 1),
        alone.own_cpu_s(_WARM_UP) / alone.frames(_WARM_UP),
        both.engine_share(2 * _WARM_UP),
    )


def write_days(bag: Path, path: Path, days: int) -> Path:
    """Write a recording that repeats `bag` on each of `days` days, with all stamps moved."""
    reader = BagReader(bag)
    with BagWriter(path, compression=CompressionType.NONE) as written:
        for day in range(days):
            for message in reader.messages():
                moved = reader.decode(message)
                moved.header.stamp = ns_to_time(stamp_of(moved) + day * DAY_NS)
                written.write(message.topic, moved, message.log_time_ns + day * DAY_NS)
    return path


class TimedCount(int):
    """Number of images of a task, with the processor time of its worker in seconds."""

    cpu_s = 0.0


def timed_work(task: Task, settings: TaskSettings) -> int:
    """Work a task and measure the processor time of all threads of the worker."""
    begin = time.process_time()
    counted = TimedCount(work(task, settings))
    counted.cpu_s = time.process_time() - begin
    return counted


class WorkedPlan:
    """A plan that an engine has worked. Raises ArchiveError if a task fails."""

    def __init__(self, planned: Plan, engine: Engine) -> None:
        self._worked, self._ends, self._spent = list[int](), list[float](), list[float]()
        for done in engine(planned.tasks, planned.settings):
            if done.error:
                raise ArchiveError(f"{done.task.label}: {done.error}")
            self._worked.append(done.worked)
            self._ends.append(time.perf_counter())
            self._spent.append(time.process_time())

    def frames(self, warm_up: int, last: int = 0) -> int:
        """Return the frames of the tasks after the first `warm_up` and before the last `last`."""
        return sum(self._worked[warm_up : len(self._worked) - last])

    def rate(self, warm_up: int, last: int) -> float:
        """Return the frames per second of those tasks."""
        return self.frames(warm_up, last) / (self._ends[-1 - last] - self._ends[warm_up - 1])

    def own_cpu_s(self, warm_up: int) -> float:
        """Return the processor time of this process after the first `warm_up` tasks."""
        return self._spent[-1] - self._spent[warm_up - 1]

    def engine_share(self, warm_up: int) -> float:
        """Return this process's share in the processor time, if workers have timed their tasks."""
        workers = sum(count.cpu_s for count in self._worked[warm_up:] if isinstance(count, TimedCount))
        return self.own_cpu_s(warm_up) / (self.own_cpu_s(warm_up) + workers)


def quiet(done: int, total: int) -> None:
    """Ignore the progress of a run."""
