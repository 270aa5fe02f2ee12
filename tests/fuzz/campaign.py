"""Runs cases of all targets for a time, keeps those that fail, and says how to repeat them.

PYTHONPATH=tests .venv/bin/python -m fuzz.campaign --minutes 20              # fresh cases; the seed is printed
PYTHONPATH=tests .venv/bin/python -m fuzz.campaign --target store --case 812 # one case again
PYTHONPATH=tests .venv/bin/python -m fuzz.campaign --target store --file out/fuzz/store-812/fuel_map.ltm
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Self
from unittest import mock

from fuzz.targets import TARGETS, target_named
from fuzz.worker import Answer, serve

MOST_SECONDS = 5.0
"""Of CPU time a case."""
MOST_BYTES = 500 << 20
"""By which the process may grow in a case."""
HANGS_AFTER = 120.0
"""Seconds on the wall, for machines that do much else: a case of `MOST_SECONDS` that gets a twentieth of a core."""
STARTS_WITHIN = 900.0
"""Seconds on the wall: kernels may have to be compiled."""


@dataclass
class Tally:
    cases: int = 0
    taken: int = 0
    seconds: float = 0.0
    bytes: int = 0
    faults: list[str] = field(default_factory=list)


_PROCESSES = multiprocessing.get_context("forkserver")
_PROCESSES.set_forkserver_preload(["fuzz.worker"])  # imports cost more than most targets' cases, and are made once


def _start_fork_server() -> None:
    """Unless it runs. It finds what it shall import: Python 3.11 gives `sys.path` to the processes and not to the
    server, which passes over in silence what it cannot import."""
    with mock.patch.dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)):
        forkserver.ensure_running()


class Worker:
    """A process for the cases of one target, started anew when it has died."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._running: tuple[BaseProcess, Connection] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()
        if self._folder is not None:
            self._folder.cleanup()

    def run(self, order: int | Path) -> Answer:
        """What came of a case, or what became of the process as a `fault`."""
        if self._running is None:
            self.start()
        assert self._running is not None
        self._running[1].send(order)
        return self._answer(HANGS_AFTER)

    def start(self) -> None:
        """Raises RuntimeError where the target does not take its own whole files."""
        if self._folder is not None:
            self._folder.cleanup()
        self._folder = tempfile.TemporaryDirectory(prefix="ltm-fuzz-", ignore_cleanup_errors=True)
        _start_fork_server()
        ours, theirs = _PROCESSES.Pipe()
        process = _PROCESSES.Process(target=serve, args=(theirs, self._name, Path(self._folder.name)), daemon=True)
        process.start()
        theirs.close()
        self._running = process, ours
        answer = self._answer(STARTS_WITHIN)
        if answer.fault or answer.refused:
            self._end()
            raise RuntimeError(f"{self._name}: its whole files are not taken: {answer.fault or answer.refused}")

    def keep(self, folder: Path) -> None:
        """Copy the file of the last case into a folder."""
        assert self._folder is not None
        file = Path(self._folder.name) / target_named(self._name).file
        if file.is_file():
            shutil.copyfile(file, folder / file.name)

    def _answer(self, seconds: float) -> Answer:
        assert self._running is not None
        process, connection = self._running
        try:
            if connection.poll(seconds):
                answer: Answer = connection.recv()
                return answer
            fault = f"no end after {seconds} s"
        except (EOFError, ConnectionError):
            process.join(5.0)
            fault = f"the process ended with {process.exitcode} (negative: that signal)"
        self._end()
        return Answer(fault)

    def _end(self) -> None:
        if self._running is not None:
            process, connection = self._running
            connection.close()
            process.kill()
            process.join()
            self._running = None


def campaign(
    names: list[str],
    seconds: float,
    seed: int,
    kept: Path,
    progress: Callable[[str, Tally], None] = lambda name, tally: None,
) -> dict[str, Tally]:
    """Cases `seed`, `seed` + 1 and so on of each target, for its share of the time. Faults are kept in `kept`.
    `progress` is told of each target that is done."""
    tallies = {}
    whole = sum(target_named(name).weight for name in names)
    for name in names:
        tallies[name] = cases(name, itertools.count(seed), seconds * target_named(name).weight / whole, kept)
        progress(name, tallies[name])
    return tallies


def cases(name: str, numbers: Iterable[int], seconds: float, kept: Path) -> Tally:
    """The cases of one target, until the time is up (its start is not counted) or twenty are at fault."""
    tally = Tally()
    with Worker(name) as worker:
        worker.start()
        until = time.monotonic() + seconds
        for number in numbers:
            answer = worker.run(number)
            fault = fault_of(answer)
            tally.cases += 1
            tally.taken += not fault and not answer.refused
            tally.seconds = max(tally.seconds, answer.seconds)
            tally.bytes = max(tally.bytes, answer.bytes)
            if fault:
                tally.faults.append(_keep(worker, name, number, fault, kept))
            if len(tally.faults) >= 20 or time.monotonic() >= until:
                break
    return tally


def fault_of(answer: Answer) -> str:
    """What was wrong in a case; empty where nothing was."""
    if answer.fault:
        return answer.fault
    if answer.seconds > MOST_SECONDS:
        return f"took {answer.seconds:.1f} s, at most {MOST_SECONDS} s"
    if answer.bytes > MOST_BYTES:
        return f"took {answer.bytes >> 20} MB, at most {MOST_BYTES >> 20} MB"
    return ""


def _keep(worker: Worker, name: str, number: int, fault: str, kept: Path) -> str:
    """The report of a fault, with the spoiled file beside it."""
    folder = kept / f"{name}-{number}"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fault.txt").write_text(fault, encoding="utf-8")
    worker.keep(folder)
    again = f"PYTHONPATH=tests .venv/bin/python -m fuzz.campaign --target {name} --case {number}"
    last = fault.strip().splitlines()[-1]
    return f"{name} case {number}: {last}\n  kept in {folder}; again: {again}"


def report(tallies: dict[str, Tally]) -> str:
    lines = [f"{'target':<24}{'cases':>8}{'taken':>8}{'most s':>8}{'most MB':>9}{'faults':>8}"]
    for name, t in tallies.items():
        lines.append(f"{name:<24}{t.cases:>8}{t.taken:>8}{t.seconds:>8.2f}{t.bytes >> 20:>9}{len(t.faults):>8}")
    whole = sum(t.cases for t in tallies.values())
    lines.append(f"{whole} cases, {sum(len(t.faults) for t in tallies.values())} faults")
    return "\n".join([*lines, *(fault for t in tallies.values() for fault in t.faults)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--seed", type=int, help="number of the first case; default: drawn, and printed")
    parser.add_argument("--target", choices=[t.name for t in TARGETS], action="append", help="default: all")
    parser.add_argument("--case", type=int, help="run this case of the target alone")
    parser.add_argument("--file", type=Path, help="run this file against the target alone")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    given = parser.parse_args()
    if given.case is not None or given.file is not None:
        with Worker(given.target[0]) as worker:
            answer = worker.run(given.case if given.file is None else given.file)
        fault = fault_of(answer)
        print(fault or f"no fault: {answer.refused or 'taken'}; {answer.seconds:.2f} s, {answer.bytes >> 20} MB")
        sys.exit(bool(fault))
    seed = random.SystemRandom().randrange(1, 1 << 31) if given.seed is None else given.seed
    print(f"seed {seed}", flush=True)
    names = given.target or [t.name for t in TARGETS]
    tallies = campaign(
        names,
        60 * given.minutes,
        seed,
        given.out,
        lambda name, tally: print(f"{name}: {tally.cases} cases, {len(tally.faults)} faults", flush=True),
    )
    print(report(tallies))
    sys.exit(any(t.faults for t in tallies.values()))


if __name__ == "__main__":
    main()
