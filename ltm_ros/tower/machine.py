"""Read and judge the state of a tower's machine: clock, disks and memory."""

import functools
import importlib.metadata
import platform
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ltm_ros.runtime.clocks import KernelClock, kernel_clock

LEAST_FREE = 0.05
"""Free share of a disk below which a warning is given."""


@dataclass(frozen=True)
class Condition:
    """One thing of a tower that may have a problem."""

    kind: str
    """`camera`, `pose`, `node`, `clock`, `disk` or `outbox`."""
    name: str
    state: str
    """`ok`, or what it is; for a camera its state."""
    problem: str
    """Problem in words; empty: none."""

    @classmethod
    def judged(cls, kind: str, name: str, state: str, problem: str) -> "Condition":
        """Return a condition with this state, or `ok` without a problem."""
        return cls(kind, name, state if problem else "ok", problem)


@dataclass(frozen=True)
class Disk:
    """Total and free bytes of a folder's file system; -1 if the folder does not exist."""

    folder: str
    total: int
    free: int

    @classmethod
    def of(cls, folder: str) -> "Disk":
        try:
            usage = shutil.disk_usage(folder)
        except OSError:
            return cls(folder, -1, -1)
        return cls(folder, usage.total, usage.free)


@dataclass(frozen=True)
class Machine:
    versions: Mapping[str, str]
    clock: KernelClock
    disks: Sequence[Disk]
    memory_total: int
    """Memory in bytes."""
    memory_available: int

    @classmethod
    def read(cls, folders: Iterable[str]) -> "Machine":
        """Return the machine's current state, with the disks of `folders`."""
        lines = (line.partition(":") for line in Path("/proc/meminfo").read_text().splitlines())
        kilobytes = {name: int(value.split()[0]) for name, _, value in lines}
        total, available = kilobytes["MemTotal"] * 1024, kilobytes["MemAvailable"] * 1024
        return cls(_versions(), kernel_clock(), [Disk.of(folder) for folder in folders], total, available)

    def conditions(self) -> Iterator[Condition]:
        if self.clock.synchronised is not None:
            problem = "The system clock is not synchronised (no NTP). Frames from different towers may not line up."
            yield Condition.judged("clock", "system", "unsynchronised", "" if self.clock.synchronised else problem)
        for disk in self.disks:
            low = f"{disk.folder}: {disk.free / 1e9:.1f} GB free of {disk.total / 1e9:.0f} GB"
            if disk.total < 0:
                yield Condition("disk", disk.folder, "missing", f"{disk.folder}: does not exist")
            else:
                yield Condition.judged("disk", disk.folder, "low", low if disk.free < LEAST_FREE * disk.total else "")


@functools.cache
def _versions() -> dict[str, str]:
    """Return the versions of the running software; marks a checkout that is not installed."""
    found = {"python": platform.python_version(), "kernel": platform.release()}
    for name in ("ltm", "numpy", "numba", "onnxruntime", "ros-rclpy"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    release = Path("/opt/ltm/current")
    if release.is_symlink():
        found["release"] = release.readlink().name
    return found
