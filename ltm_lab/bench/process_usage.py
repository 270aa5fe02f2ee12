"""What processes take, from /proc: memory, processor time, descriptors, threads; and what lies in /dev/shm."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ltm_ros.launching import shared_memory
from ltm_ros.launching.watchdog import process_use


@dataclass(frozen=True)
class Usage:
    """Of one process. Memory in kB: `pss` counts a page that n processes share as 1/n; `private` is its alone."""

    pss: int
    private: int
    """Pages of files that it has mapped among them (libraries, kernels), as long as no other process has mapped the
    same: they change by megabytes when processes of any other program come and go."""
    own: int
    """What it has asked for: anonymous memory, and its part of shared memory. Nobody else's doing changes it."""
    descriptors: int
    threads: int
    cpu_s: float


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
    private = sizes["Private_Clean"] + sizes["Private_Dirty"]
    own = sizes["Pss_Anon"] + sizes["SwapPss"] + sizes["Pss_Shmem"]
    return Usage(sizes["Pss"], private, own, descriptors, int(threads[1]), process_use(pid).cpu_s)


def usage_of(processes: Mapping[str, int]) -> dict[str, Usage]:
    """By label; without those that are gone."""
    found = {label: usage(pid) for label, pid in processes.items()}
    return {label: one for label, one in found.items() if one is not None}


def shared_memory_objects() -> int:
    """Segments and ports of Fast DDS on the whole machine."""
    seen = shared_memory.survey(min_age_s=0.0)
    return len(seen.in_use) + len(seen.stale) + len(seen.young)
