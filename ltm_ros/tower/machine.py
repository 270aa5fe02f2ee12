"""Read and judge the state of a tower's machine: clock, disks, memory, and the memory of the graph's processes."""

from __future__ import annotations

import functools
import importlib.metadata
import math
import platform
import shutil
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ltm_ros.runtime.clocks import KernelClock

KEPT_S = 5.0
"""Seconds for which the memory of processes is cached."""
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


def processes_of(parent: int) -> dict[str, int]:
    """Return the resident bytes of the nodes' processes that the runner `parent` started (of shared pages, their
    share)."""
    found: dict[str, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if int((folder / "stat").read_text().rpartition(")")[2].split()[1]) != parent:
                continue
            words = (folder / "cmdline").read_text().split("\0")
            if "ltm_ros.launching.supervised" not in words:
                continue
            name = _label(words)
            found[name] = found.get(name, 0) + _proportional(folder)
        except (OSError, ValueError):
            continue  # it has just ended
    return found


class ProcessMemory:
    """`processes_of` the runner `parent`, read once in `KEPT_S`, because the kernel walks all pages of a process for
    it. Thread-safe."""

    def __init__(self, parent: int) -> None:
        self._parent = parent
        self._used: dict[str, int] = {}
        self._looked_s = -math.inf
        self._lock = threading.Lock()

    def used(self, now_s: float) -> dict[str, int]:
        with self._lock:
            if now_s - self._looked_s > KEPT_S:
                self._used, self._looked_s = processes_of(self._parent), now_s
            return self._used


def _label(words: list[str]) -> str:
    """Return `depth`, or `north/depth` if its arguments name a namespace."""
    module = words[words.index("ltm_ros.launching.supervised") + 1].rpartition(".")[2]
    space = next((word.partition(":=")[2] for word in words if word.startswith("__ns:=")), "")
    camera = "/".join(space.split("/")[2:])
    return f"{camera}/{module}" if camera else module


def _proportional(folder: Path) -> int:
    for line in (folder / "smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) * 1024
    return 0


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
