"""Picks an unused path for a node's output, so that a restarted node never overwrites what it wrote before."""

from __future__ import annotations

from pathlib import Path


def free_path(path: Path) -> Path:
    """`path`, or the first of `name_1`, `name_2`, ... (before the suffix of a file) that is not there.

    An empty folder counts as not there.
    """
    candidate, n = path, 0
    while candidate.is_file() or (candidate.is_dir() and any(candidate.iterdir())):
        n += 1
        candidate = path.with_name(f"{path.stem}_{n}{path.suffix}")
    return candidate
