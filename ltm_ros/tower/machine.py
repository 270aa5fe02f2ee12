"""Read and judge the state of a tower's machine: clock, disks and memory."""

from __future__ import annotations

import functools
import importlib.metadata
import platform
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ltm_ros.runtime.clocks import KernelClock

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
    def judged(cls, kind: str, name: str, state: str, problem: str) -> Condition:
        """Return a condition with this state, or `ok` without a problem."""
        return cls(kind, name, state if problem else "ok", problem)


@dataclass(frozen=True)
class Disk:
    folder: str
    total: int
    free: int


def disks(folders: Iterable[str]) -> list[Disk]:
    """Return total and free bytes of each folder's file system; -1 if the folder does not exist."""
    found = []
    for folder in folders:
        try:
            usage = shutil.disk_usage(folder)
            found.append(Disk(folder, usage.total, usage.free))
        except OSError:
            found.append(Disk(folder, -1, -1))
    return found


def machine_conditions(clock: KernelClock, disks: Iterable[Disk]) -> Iterator[Condition]:
    if clock.synchronised is not None:
        problem = "The system clock is not synchronised (no NTP). Frames from different towers may not line up."
        yield Condition.judged("clock", "system", "unsynchronised", "" if clock.synchronised else problem)
    for disk in disks:
        low = f"{disk.folder}: {disk.free / 1e9:.1f} GB free of {disk.total / 1e9:.0f} GB"
        if disk.total < 0:
            yield Condition("disk", disk.folder, "missing", f"{disk.folder}: does not exist")
        else:
            yield Condition.judged("disk", disk.folder, "low", low if disk.free < LEAST_FREE * disk.total else "")


def memory() -> tuple[int, int]:
    """Return total and available memory of the machine in bytes."""
    sizes = {}
    for line in Path("/proc/meminfo").read_text().splitlines():
        name, _, value = line.partition(":")
        sizes[name] = int(value.split()[0]) * 1024
    return sizes["MemTotal"], sizes["MemAvailable"]


@functools.cache
def versions() -> dict[str, str]:
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
