"""Measures how much faster two processes work an archive than one: many days, once kernels and networks are there."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from ltm_core.base.errors import ArchiveError
from ltm_core.base.utc_time import DAY_NS
from ltm_lab.bench.archive_worker import EngineShare, TimedReport, timed_work
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.stamp import ns_to_time, stamp_of
from ltm_ros.archive.engine import Engine, on_workers, serial
from ltm_ros.archive.run import ArchiveOptions, Plan, look_through
from ltm_ros.archive.task import TaskReport

_WARMING = 2
"""Tasks of each process, of which the first loads kernels and networks, that are not counted."""


@dataclass(frozen=True)
class Speedup:
    """Frames a second, of tasks of `frames` each, by one process and by two beside each other; `share`: what of
    processor time the engine of the two took."""

    tasks: int
    frames: int
    alone: float
    together: float
    share: EngineShare

    @property
    def times(self) -> float:
        return self.together / self.alone


def measure_speedup(bag: Path, site: Path, folder: Path, days: int, said: Callable[[str], None]) -> Speedup:
    """Of a recording that is repeated on so many days, in an empty `folder`. Raises ArchiveError for too few days."""
    said(f"writing {days} days")
    days_bag = write_days(bag, folder / "days", days)
    options = ArchiveOptions((days_bag,), site, str(folder / "serial"))
    planned = look_through(options, _quiet)
    if len(planned.tasks) < 4 * _WARMING + 2:
        raise ArchiveError(f"{days} days make {len(planned.tasks)} tasks, too few to measure two processes: give more")
    said(f"{len(planned.tasks)} tasks, one process")
    alone = WorkedPlan(planned, serial).rate(_WARMING, 0)
    said("two processes")
    apart = look_through(replace(options, out=str(folder / "apart")), _quiet)
    both = WorkedPlan(apart, on_workers(2, timed_work))
    together, share = both.rate(2 * _WARMING, 1), both.share(2 * _WARMING)
    return Speedup(len(planned.tasks), max(len(task.frames) for task in planned.tasks), alone, together, share)


def write_days(bag: Path, path: Path, days: int) -> Path:
    """A recording with that of `bag` on each of so many days, all stamps moved with it."""
    reader = BagReader(bag)
    with BagWriter(path, compression=None) as written:
        for day in range(days):
            for message in reader.messages():
                moved = reader.decode(message)
                moved.header.stamp = ns_to_time(stamp_of(moved) + day * DAY_NS)
                written.write(message.topic, moved, message.log_time_ns + day * DAY_NS)
    return path


class WorkedPlan:
    """A plan that an engine has worked. Raises ArchiveError where a task fails."""

    def __init__(self, planned: Plan, engine: Engine) -> None:
        self._reports, self._ends, self._spent = list[TaskReport](), list[float](), list[float]()
        self._most = max(len(task.frames) for task in planned.tasks)
        for done in engine(planned.tasks, planned.settings):
            if done.report is None:
                raise ArchiveError(f"{done.task.label}: {done.error}")
            self._reports.append(done.report)
            self._ends.append(time.perf_counter())
            self._spent.append(time.process_time())

    def rate(self, warming: int, last: int) -> float:
        """Frames a second between the ends of the `warming`-th task and of the `last`-th from the end, when one process
        works no longer."""
        end = len(self._ends) - 1 - last
        frames = sum(report.worked for report in self._reports[warming : end + 1])
        return frames / (self._ends[end] - self._ends[warming - 1])

    def share(self, warming: int) -> EngineShare:
        """Of an engine that times its tasks in other processes, from the end of the `warming`-th task on."""
        of_tasks = sum(report.cpu_s for report in self._reports[warming:] if isinstance(report, TimedReport))
        count = len(self._reports) - warming
        return EngineShare(self._most, count, of_tasks, self._spent[-1] - self._spent[warming - 1])


def _quiet(done: int, total: int) -> None:
    """Nobody watches."""
