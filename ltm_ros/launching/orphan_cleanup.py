"""Cleans up after a graph whose runner was killed: ends its processes, removes its folders and shared memory.

`python -m ltm_ros.launching.orphan_cleanup` runs beside the runner, which is at its stdin.

The runner tells it the process groups and temporary folders that exist. When the pipe closes (the runner is gone,
however it went), whatever is still listed is ended and removed, and so is the shared memory that it leaves. A runner
that stops in order has emptied the list by then. Where it lies still itself, it goes on when the runner ends, for
that. Nodes end without it too (`supervised`); shared memory and folders are removed by it alone. Standard library only,
so that it costs little to have around.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import time
from collections.abc import Iterable
from typing import TextIO

from ltm_ros.launching import shared_memory
from ltm_ros.launching.supervised import signal_at_parents_death

GRACE_S = 5.0


def group_alive(group: int) -> bool:
    """Whether any process of the group is left (zombies count, the dead and reaped do not)."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def end_groups(groups: Iterable[int], grace_s: float = GRACE_S) -> None:
    """SIGTERM, after `grace_s` SIGKILL to each group; returns when all are gone, or 1 s after that."""
    left = set(groups)
    for number, patience_s in ((signal.SIGTERM, grace_s), (signal.SIGKILL, 1.0)):
        for group in left:
            try:
                os.killpg(group, number)
            except (ProcessLookupError, PermissionError):
                continue
        deadline = time.monotonic() + patience_s
        while left and time.monotonic() < deadline:
            left = {group for group in left if group_alive(group)}
            time.sleep(0.02)
        if not left:
            return


def clean_up_at_end(orders: TextIO) -> None:
    """Follow orders (`group N`, `forget N`, `folder PATH`, `forget-folder PATH`, one a line) until the pipe closes."""
    groups: set[int] = set()
    folders: set[str] = set()
    for line in orders:
        order, _, value = line.rstrip("\n").partition(" ")
        if order == "group":
            groups.add(int(value))
        elif order == "forget":
            groups.discard(int(value))
        elif order == "folder":
            folders.add(value)
        elif order == "forget-folder":
            folders.discard(value)
    if groups:
        end_groups(groups)
        time.sleep(shared_memory.MIN_AGE_S)
        shared_memory.remove_stale()
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)


def main() -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal_at_parents_death(signal.SIGCONT)
    clean_up_at_end(sys.stdin)


if __name__ == "__main__":
    main()
