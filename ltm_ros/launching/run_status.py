"""What a runner's processes are at, in a line for a person and a word for the watchdog."""

from __future__ import annotations

from collections.abc import Iterable

from ltm_ros.launching.supervisor import NodeProcess, ProcessState

LONGEST = 200
"""Characters of a line: service managers show it in one."""


def in_words(processes: Iterable[NodeProcess]) -> str:
    """Which processes do not run, and why; else how many do."""
    seen = list(processes)
    down = [process for process in seen if not process.running]
    if not down:
        return f"all {len(seen)} processes run"
    told = ", ".join(_one(process) for process in down)
    line = f"{len(seen) - len(down)} of {len(seen)} processes run; down: {told}"
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..."


def all_watched(processes: Iterable[NodeProcess]) -> bool:
    """Whether each process is followed, on its way back, or given up: nothing that a restart of the runner would mend.

    What a camera sends does not matter: one that is offline must not restart the tower.
    """
    return all(process.watched for process in processes)


def _one(process: NodeProcess) -> str:
    if process.state is ProcessState.GIVEN_UP:
        return f"{process.label} (given up, {process.last_exit})"
    return f"{process.label} ({process.last_exit or 'starts'})"
