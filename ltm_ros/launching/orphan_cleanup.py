"""Clean up after a runner that was killed: end its processes, remove its folders and shared memory.

`python -m ltm_ros.launching.orphan_cleanup` runs beside the runner, which is connected to its stdin.

The runner sends it the existing process groups and temporary folders. When the pipe closes because the runner has
ended, it ends and removes everything that is still listed, and the shared memory left behind. A runner that stops in
order has emptied the list by then. If this process was stopped (SIGSTOP), it is continued when the runner ends. Nodes
also end without it (`supervised`), but only it removes shared memory and folders. It uses only the standard library, to
stay small.
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
    """Return whether any process of the group exists (including zombies)."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def end_groups(groups: Iterable[int], grace_s: float = GRACE_S) -> None:
    """Send SIGTERM to each group, and SIGKILL after `grace_s`; return when all have ended, at most 1 s later."""
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
    """Read orders (`group N`, `forget N`, `folder PATH`, `forget-folder PATH`, one per line) until the pipe closes."""
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
