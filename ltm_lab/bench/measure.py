"""Measure processor time, wall time and memory of a call, and describe the machine that ran it."""

import os
import platform
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Cost:
    """Milliseconds of one call. Compare processor time: wall time varies with the load of the machine."""

    cpu_ms: float
    wall_ms: float

    def scaled(self, factor: float) -> "Cost":
        """Return the cost of `factor` times the work."""
        return Cost(self.cpu_ms * factor, self.wall_ms * factor)


def cost_of(call: Callable[[], Any]) -> Cost:
    """Return the cost of a single call."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return Cost((time.process_time() - cpu) * 1e3, (time.perf_counter() - wall) * 1e3)


def least_cost(call: Callable[[], Any], repeats: int, at_most_s: float = 20.0) -> Cost:
    """Return the least processor time and the least wall time of several calls; stop after `at_most_s` seconds."""
    costs: list[Cost] = []
    end = time.perf_counter() + at_most_s
    while len(costs) < repeats and (not costs or time.perf_counter() < end):
        costs.append(cost_of(call))
    return Cost(min(c.cpu_ms for c in costs), min(c.wall_ms for c in costs))


def own_process() -> ProcessPoolExecutor:
    """Return an executor with one fresh process, whose memory and processor time are those of its own work."""
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"))


def in_own_process(
    function: Callable[_Parameters, _Result], *args: _Parameters.args, **kwargs: _Parameters.kwargs
) -> _Result:
    """Call a module-level function in a fresh process and return its result.

    Raises what the function raises, and BrokenProcessPool if the process dies.
    """
    with own_process() as process:
        return process.submit(function, *args, **kwargs).result()


def peak_mb() -> float:
    """Return the peak memory of this process, MB."""
    try:
        # Linux adds the parent's memory before exec to ru_maxrss; the high-water mark belongs to this process alone.
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) * 1024 / 1e6
    except (OSError, StopIteration):
        pass
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def resident_mb() -> float:
    """Return the memory of this process, MB, or its peak on systems without /proc."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return peak_mb()
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def available_mb() -> float | None:
    """Return the available memory of this machine, MB, or None on systems without /proc."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) / 1e3 for line in lines if line.startswith("MemAvailable")), None)


@dataclass(frozen=True)
class Machine:
    """The machine, its load and the package versions behind a set of figures."""

    cpu: str
    cores: int
    load_average: tuple[float, float, float]
    python: str
    versions: dict[str, str]

    def as_dict(self) -> dict[str, Any]:
        """Return all fields, for JSON."""
        return asdict(self)


def conditions(packages: tuple[str, ...]) -> Machine:
    """Describe this machine now; packages that are not installed are left out."""
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
