"""What processes wait for, beside `ltm_lab.bench.process_usage`."""

from __future__ import annotations

from pathlib import Path


def waited_s(pid: int) -> float:
    """Seconds for which a process's main thread was ready to run, and others had the cores; 0 where it is gone."""
    try:
        return int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[1]) / 1e9
    except (OSError, IndexError):
        return 0.0
