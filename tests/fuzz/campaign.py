"""Runs cases of all targets for a time, keeps those that fail, and says how to repeat them.

PYTHONPATH=tests python -m fuzz.campaign --minutes 20              # fresh cases; the seed is printed
PYTHONPATH=tests python -m fuzz.campaign --target store --case 812 # one case again
PYTHONPATH=tests python -m fuzz.campaign --target store --file out/fuzz/store-812/fuel_map.ltm
"""

from __future__ import annotations

import argparse
import json
import os
import random
import select
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

from fuzz.targets import TARGETS, target_named

MOST_SECONDS = 5.0
"""Of CPU time a case."""
MOST_BYTES = 500 << 20
"""By which the process may grow in a case."""
HANGS_AFTER = 40.0
"""Seconds on the wall, for machines that do much else."""
STARTS_WITHIN = 180.0
_TESTS = Path(__file__).parents[1]


@dataclass
class Tally:
    cases: int = 0
    taken: int = 0
    seconds: float = 0.0
    bytes: int = 0
    faults: list[str] = field(default_factory=list)


class Worker:
    """A process for the cases of one target, started anew when it has died."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._process: subprocess.Popen[str] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        self._end()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout):
                if stream is not None:
                    stream.close()
            self._process = None

    def keep(self, folder: Path) -> None:
        """Copy the file of the last case into a folder."""
        assert self._folder is not None
        file = Path(self._folder.name) / target_named(self._name).file
        if file.is_file():
            shutil.copyfile(file, folder / file.name)

    def run(self, order: str) -> dict[str, object]:
        """The worker's answer, or what became of the worker as a `fault`."""
        if self._process is None:
            self._start()
        process = self._process
        assert process is not None
        assert process.stdin is not None
        process.stdin.write(f"{order}\n")
        process.stdin.flush()
        answer = self._answer(HANGS_AFTER)
        if isinstance(answer, dict):
            return answer
        self._end()
        return {"fault": answer, "seconds": 0.0, "bytes": 0}

    def _start(self) -> None:
        if self._folder is not None:
            self._folder.cleanup()
        self._folder = tempfile.TemporaryDirectory(prefix="ltm-fuzz-", ignore_cleanup_errors=True)
        path = os.pathsep.join([str(_TESTS), str(_TESTS.parent), os.environ.get("PYTHONPATH", "")])
        self._process = subprocess.Popen(
            [sys.executable, "-m", "fuzz.worker", self._name, self._folder.name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            bufsize=1,
            env={**os.environ, "PYTHONPATH": path},
        )
        answer = self._answer(STARTS_WITHIN)
        if not isinstance(answer, dict) or not answer["ready"]:
            self.stop()
            raise RuntimeError(f"{self._name}: its whole files are not read: {answer}")

    def _answer(self, seconds: float) -> dict[str, object] | str:
        assert self._process is not None
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], seconds)
        if not ready:
            return f"no end after {seconds} s"
        line = self._process.stdout.readline()
        if line:
            found: dict[str, object] = json.loads(line)
            return found
        return f"the process ended with {self._process.wait()} (negative: that signal)"


def campaign(names: list[str], seconds: float, seed: int, kept: Path) -> dict[str, Tally]:
    """Cases `seed`, `seed` + 1 and so on of each target, for its share of the time. Faults are kept in `kept`."""
    tallies = {name: Tally() for name in names}
    whole = sum(target_named(name).weight for name in names)
    for name in names:
        tally, number = tallies[name], seed
        with Worker(name) as worker:
            worker.run(str(number))  # the start of the process is not counted
            until = time.monotonic() + seconds * target_named(name).weight / whole
            while time.monotonic() < until:
                answer = worker.run(str(number))
                fault = fault_of(answer)
                tally.cases += 1
                tally.taken += not fault and not answer.get("refused")
                tally.seconds = max(tally.seconds, float(str(answer["seconds"])))
                tally.bytes = max(tally.bytes, int(str(answer["bytes"])))
                if fault:
                    tally.faults.append(_keep(worker, name, number, fault, kept))
                    if len(tally.faults) >= 20:
                        break
                number += 1
    return tallies


def fault_of(answer: dict[str, object]) -> str:
    """What was wrong in a case; empty where nothing was."""
    if answer["fault"]:
        return str(answer["fault"])
    if float(str(answer["seconds"])) > MOST_SECONDS:
        return f"took {answer['seconds']:.1f} s, at most {MOST_SECONDS} s"
    if int(str(answer["bytes"])) > MOST_BYTES:
        return f"took {int(str(answer['bytes'])) >> 20} MB, at most {MOST_BYTES >> 20} MB"
    return ""


def _keep(worker: Worker, name: str, number: int, fault: str, kept: Path) -> str:
    """The report of a fault, with the spoiled file beside it."""
    folder = kept / f"{name}-{number}"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fault.txt").write_text(fault, encoding="utf-8")
    worker.keep(folder)
    again = f"PYTHONPATH=tests python -m fuzz.campaign --target {name} --case {number}"
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
            answer = worker.run(str(given.case) if given.file is None else f"FILE {given.file.resolve()}")
        fault = fault_of(answer)
        print(fault or f"no fault: {answer.get('refused') or 'taken'}; {answer['seconds']:.2f} s CPU")
        sys.exit(bool(fault))
    seed = random.SystemRandom().randrange(1, 1 << 31) if given.seed is None else given.seed
    print(f"seed {seed}", flush=True)
    tallies = campaign(given.target or [t.name for t in TARGETS], 60 * given.minutes, seed, given.out)
    print(report(tallies))
    sys.exit(any(t.faults for t in tallies.values()))


if __name__ == "__main__":
    main()
