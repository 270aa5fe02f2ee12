"""Read what processes use from /proc: memory, processor time, descriptors and threads."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ltm_ros.launching.watchdog import process_use


@dataclass(frozen=True)
class Usage:
    """What one process uses. Memory is in kB."""

    pss: int
    """Memory of the process; a page that n processes share counts as 1/n."""
    private: int
    """Pages that no other process has mapped. Pages of mapped files (libraries, kernels) are included as long as the
    process alone maps them, so this changes by megabytes when other programs start and end."""
    own: int
    """Memory that the process allocated: anonymous memory, and its part of shared memory."""
    descriptors: int
    threads: int
    cpu_s: float


def usage(pid: int) -> Usage | None:
    """Return what a process uses, or None if it has ended."""
    try:
        rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
        status = Path(f"/proc/{pid}/status").read_text()
        descriptors = sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())
    except OSError:
        return None
    sizes = {name: int(kb) for name, kb in re.findall(r"^(\w+): +(\d+) kB$", rollup, re.MULTILINE)}
    threads = re.search(r"^Threads:\s+(\d+)$", status, re.MULTILINE)
    if "Pss" not in sizes or threads is None:
        return None  # it is ending
    private = sizes["Private_Clean"] + sizes["Private_Dirty"]
    own = sizes["Pss_Anon"] + sizes["SwapPss"] + sizes["Pss_Shmem"]
    return Usage(sizes["Pss"], private, own, descriptors, int(threads[1]), process_use(pid)[1])


def usage_of(processes: Mapping[str, int]) -> dict[str, Usage]:
    """Return what processes use by label, without those that have ended."""
    found = {label: usage(pid) for label, pid in processes.items()}
    return {label: one for label, one in found.items() if one is not None}
