"""A process that runs cases of one target after another and measures each; the suite replaces it when it dies."""

from __future__ import annotations

import contextlib
import gc
import os
import resource
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from fuzz.targets import target_named
from ltm_core.base.errors import LtmError

SPARE = 2 << 30
"""Bytes that a process may take beyond what it begins with: faults end here, not the machine."""


def _status(key: str) -> int:
    """Bytes of a line of this process's status."""
    text = Path("/proc/self/status").read_text()
    return int(text.split(f"{key}:")[1].split()[0]) << 10


@dataclass(frozen=True)
class Answer:
    """What came of a case. `fault`: empty, or what was raised besides LtmError. `refused`: the LtmError's words.
    `seconds`: of CPU time. `bytes`: by which the process grew at most."""

    fault: str = ""
    refused: str = ""
    seconds: float = 0.0
    bytes: int = 0


def _measured(folder: Path, read: Callable[[Path], object], file: Path, data: bytes) -> Answer:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
    before, begun = _status("VmRSS"), time.process_time()
    fault = refused = ""
    try:
        read(folder)
    except LtmError as error:
        refused = str(error)[:200]
        if not str(error):
            fault = "an LtmError without a message"
    except BaseException:
        fault = traceback.format_exc()
    seconds, grown = time.process_time() - begun, _status("VmHWM") - before
    return Answer(fault, refused, seconds, max(0, grown))


def serve(connection: Connection, name: str, folder: Path) -> None:
    """Answer each case, a number or the path of a file, with what came of it; the first answer is of the whole files.

    Args:
        folder: empty, to work in.
    """
    null = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):  # libraries print
        os.dup2(null, stream)
    warnings.simplefilter("ignore")
    target = target_named(name)
    try:
        seeds = target.seeds(folder)
    except Exception:
        connection.send(Answer(traceback.format_exc()))
        return
    file = folder / target.file
    for seed in seeds:  # what is compiled or imported once is not counted
        answer = _measured(folder, target.read, file, seed)
        if answer.fault or answer.refused:
            connection.send(answer)
            return
    most = _status("VmSize") + SPARE
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    connection.send(Answer())
    while True:
        try:
            order: int | Path = connection.recv()
        except EOFError:
            return
        try:
            data = order.read_bytes() if isinstance(order, Path) else target.case(order, seeds)
        except Exception:
            connection.send(Answer("this case could not be made:\n" + traceback.format_exc()))
            continue
        if _status("VmSize") > most - SPARE // 2:
            gc.collect()  # cycles that earlier cases left, some 80 MB of a terrain's handler, are no fault of this
        connection.send(_measured(folder, target.read, file, data))
