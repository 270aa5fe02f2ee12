"""Kills whatever works an archive, at random moments: workers, and the command itself with its scheduler."""

from __future__ import annotations

import contextlib
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from ltm_core.base.errors import ArchiveError
from ltm_ros.archive.plan import EVIDENCE
from ltm_ros.archive.results import ResultFolder

_PATIENCE_S = 600.0
"""Seconds without a new result, after which a run is given up."""


def run_under_kills(bag: Path, site: Path, out: Path, kills: int, chance: random.Random) -> tuple[int, int]:
    """Have `ltm reprocess` make a map on two processes and kill one of its processes, or all of it with the scheduler,
    after every few results and at moments of chance, until that was done `kills` times; a command that is gone is run
    again, and once more at last, to the end. How many workers and how many commands were killed.

    What was left to do is too little for many kills where results stay, so some of them are taken away again: of the
    tasks' files, half, by chance. Raises ArchiveError where a run fails or stands still.
    """
    command = [sys.executable, "-m", "ltm_ros.cli.main", "reprocess", str(bag), "--site", str(site), "--out", str(out)]
    command += ["--frames-per-task", "1", "--workers", "2"]
    workers = commands = 0
    results = ResultFolder(str(out))
    while workers + commands < kills:
        _forget_some(results, chance)
        # A file: nobody reads a pipe meanwhile, and a full one would stop the run.
        with (
            tempfile.TemporaryFile() as told,
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=told) as process,
        ):
            while process.poll() is None and workers + commands < kills:
                _wait_for_results(process, results, chance.randint(1, 2))
                time.sleep(chance.uniform(0.0, 0.3))
                if chance.random() < 0.5:
                    workers += _kill_a_worker(process, chance)
                elif process.poll() is None:
                    process.kill()
                    commands += 1
            if process.poll() is None:
                process.kill()
            if process.wait() not in (0, -signal.SIGKILL):
                told.seek(0)
                raise ArchiveError(f"a run under kills failed: {told.read().decode(errors='replace')[-400:]}")
    return workers, commands


def _forget_some(results: ResultFolder, chance: random.Random) -> None:
    for name in sorted(results.names(EVIDENCE)):
        if chance.random() < 0.5:
            results.remove(f"{EVIDENCE}/{name}")


def _wait_for_results(process: subprocess.Popen[bytes], results: ResultFolder, more: int) -> None:
    """Until so many more are there, or the process has ended."""
    before, begin = len(results.names(EVIDENCE)), time.monotonic()
    while process.poll() is None and len(results.names(EVIDENCE)) < before + more:
        if time.monotonic() > begin + _PATIENCE_S:
            process.kill()
            raise ArchiveError(f"a run under kills made no result for {_PATIENCE_S:.0f} s")
        time.sleep(0.05)


def _kill_a_worker(process: subprocess.Popen[bytes], chance: random.Random) -> int:
    with contextlib.suppress(psutil.NoSuchProcess):
        children = psutil.Process(process.pid).children(recursive=True)
        workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
        if workers:
            chance.choice(workers).kill()
            return 1
    return 0
