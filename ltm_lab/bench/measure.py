"""Measures the cost of a call: processor time over all threads, wall time and memory, and describes the machine."""

from __future__ import annotations

import os
import platform
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Cost:
    """Milliseconds of one call. Processor time is what is compared: wall time on a shared machine moves severalfold."""

    cpu_ms: float
    wall_ms: float

    def scaled(self, factor: float) -> Cost:
        """The cost of `factor` times the work."""
        return Cost(self.cpu_ms * factor, self.wall_ms * factor)


def cost_of(call: Callable[[], Any]) -> Cost:
    """One call, timed once."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return Cost((time.process_time() - cpu) * 1e3, (time.perf_counter() - wall) * 1e3)


def least_cost(call: Callable[[], Any], repeats: int, at_most_s: float = 20.0) -> Cost:
    """The least processor and the least wall time of several calls, which end early once they took `at_most_s`."""
    costs: list[Cost] = []
    end = time.perf_counter() + at_most_s
    while len(costs) < repeats and (not costs or time.perf_counter() < end):
        costs.append(cost_of(call))
    return Cost(min(c.cpu_ms for c in costs), min(c.wall_ms for c in costs))


def peak_mb() -> float:
    """Most memory that this process ever held, MB."""
    try:
        # Linux counts what the parent held before exec into ru_maxrss; the high-water mark is this process's own.
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) * 1024 / 1e6
    except (OSError, StopIteration):
        pass
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def resident_mb() -> float:
    """Memory that this process holds now, MB; its peak where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return peak_mb()
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def available_mb() -> float | None:
    """Memory that is free for use on this machine, MB; None where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) / 1e3 for line in lines if line.startswith("MemAvailable")), None)


@dataclass(frozen=True)
class Machine:
    """The machine and the versions behind a set of figures."""

    cpu: str
    cores: int
    load_average: tuple[float, float, float]
    python: str
    versions: dict[str, str]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def conditions(packages: tuple[str, ...]) -> Machine:
    """Those of now; packages that are not installed are left out."""
    found = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Machine(_cpu_name(), cores, os.getloadavg(), platform.python_version(), found)


def _cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.machine())
