"""What processes take: memory, descriptors, threads, from /proc; and /dev/shm and folders."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ltm_ros.launching import shared_memory


@dataclass(frozen=True)
class Usage:
    """Of one process. Memory in kB: `pss` counts a page that n processes share as 1/n; `private` is its alone."""

    pss: int
    private: int
    descriptors: int
    threads: int


def usage(pid: int) -> Usage | None:
    """None where the process is gone."""
    try:
        rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
        status = Path(f"/proc/{pid}/status").read_text()
        descriptors = sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())
    except OSError:
        return None
    sizes = {name: int(kb) for name, kb in re.findall(r"^(\w+): +(\d+) kB$", rollup, re.MULTILINE)}
    threads = re.search(r"^Threads:\s+(\d+)$", status, re.MULTILINE)
    if "Pss" not in sizes or threads is None:
        return None  # ends just now
    return Usage(sizes["Pss"], sizes["Private_Clean"] + sizes["Private_Dirty"], descriptors, int(threads[1]))


def waited_s(pid: int) -> float:
    """Seconds for which a process's main thread was ready to run, and others had the cores; 0 where it is gone."""
    try:
        return int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[1]) / 1e9
    except (OSError, IndexError):
        return 0.0


def usage_of(processes: Mapping[str, int]) -> dict[str, Usage]:
    """By label; without those that are gone."""
    found = {label: usage(pid) for label, pid in processes.items()}
    return {label: one for label, one in found.items() if one is not None}


def shared_memory_objects() -> int:
    """Segments and ports of Fast DDS on the whole machine."""
    seen = shared_memory.survey(min_age_s=0.0)
    return len(seen.in_use) + len(seen.stale) + len(seen.young)


def folder_bytes(folder: Path) -> int:
    """Of all files below, as far as they are there."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except OSError:
            continue
    return total
