"""What a tower's machine says of itself: its clock, memory, disks, and the memory of the graph's processes."""

from __future__ import annotations

import ctypes
import functools
import importlib.metadata
import os
import platform
import shutil
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

_TIME_ERROR = 5
"""What adjtimex(2) returns while nothing keeps the clock right."""


class _Timex(ctypes.Structure):
    """struct timex of Linux on machines with 64 bits."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        *((name, ctypes.c_long) for name in ("offset", "freq", "maxerror", "esterror")),
        ("status", ctypes.c_int),
        *((name, ctypes.c_long) for name in ("constant", "precision", "tolerance", "seconds", "micros", "tick")),
        *((name, ctypes.c_long) for name in ("ppsfreq", "jitter")),
        ("shift", ctypes.c_int),
        *((name, ctypes.c_long) for name in ("stabil", "jitcnt", "calcnt", "errcnt", "stbcnt")),
        ("tai", ctypes.c_int),
        ("rest", ctypes.c_int * 11),
    )


@dataclass(frozen=True)
class Clock:
    synchronised: bool | None
    """Whether the kernel says that something keeps its clock right; None: it does not tell."""
    estimated_error_s: float | None


def clock() -> Clock:
    """Asked without rights and without a change (`modes` = 0)."""
    asked = _Timex()
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(asked))
    if state < 0:
        return Clock(None, None)
    synchronised = state != _TIME_ERROR
    return Clock(synchronised, asked.esterror / 1e6 if synchronised else None)


@dataclass(frozen=True)
class Disk:
    folder: str
    total: int
    free: int


def disks(folders: Iterable[str]) -> list[Disk]:
    """Bytes of the file system of each folder that is there; -1 of one that is not."""
    found = []
    for folder in folders:
        try:
            usage = shutil.disk_usage(folder)
            found.append(Disk(folder, usage.total, usage.free))
        except OSError:
            found.append(Disk(folder, -1, -1))
    return found


def memory() -> tuple[int, int]:
    """Bytes of the machine's memory, and those that are available."""
    sizes = {}
    for line in Path("/proc/meminfo").read_text().splitlines():
        name, _, value = line.partition(":")
        sizes[name] = int(value.split()[0]) * 1024
    return sizes["MemTotal"], sizes["MemAvailable"]


def processes_of(parent: int) -> dict[str, int]:
    """Resident bytes (proportional where pages are shared) of the nodes' processes that the runner `parent` started."""
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


def _label(words: list[str]) -> str:
    """`depth`, or `north/depth` where its arguments name a namespace."""
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
    """Of what runs here; a checkout that is not installed says so."""
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


def boot_age_s() -> float:
    """Seconds since the machine was started, time asleep included."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def runner_pid() -> int:
    return os.getppid()
