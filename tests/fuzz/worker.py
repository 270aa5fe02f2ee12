"""A process that runs cases of one target after another and measures each; the suite replaces it when it dies.

Its arguments: the target's name, and an empty folder to work in. Takes lines `NUMBER` (or `FILE path`) on standard input, and answers each with a line of JSON.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import sys
import time
import traceback
import warnings
from pathlib import Path

from fuzz.targets import target_named

SPARE = 2 << 30
"""Bytes that a process may take beyond what it begins with: faults end here, not the machine."""


def _status(key: str) -> int:
    """Bytes of a line of this process's status."""
    text = Path("/proc/self/status").read_text()
    return int(text.split(f"{key}:")[1].split()[0]) << 10


def _measured(folder: Path, run: object, file: Path, data: bytes) -> dict[str, object]:
    from ltm_core.errors import LtmError

    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
    before, begun = _status("VmRSS"), time.process_time()
    fault = refused = ""
    try:
        run(folder)  # type: ignore[operator]
    except LtmError as error:
        refused = str(error)[:200]
        if not str(error):
            fault = "an LtmError without a message"
    except BaseException:
        fault = traceback.format_exc()
    seconds, grown = time.process_time() - begun, _status("VmHWM") - before
    return {"fault": fault, "refused": refused, "seconds": seconds, "bytes": max(0, grown)}


def main() -> None:
    target = target_named(sys.argv[1])
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries print
    warnings.simplefilter("ignore")
    folder = Path(sys.argv[2])
    seeds = target.seeds(folder)
    file = folder / target.file
    for seed in seeds:  # whole files are read; and what is compiled or imported once is not counted
        answer = _measured(folder, target.read, file, seed)
        if answer["fault"] or answer["refused"]:
            print(json.dumps(answer | {"ready": False}), file=answers)
            return
    most = _status("VmSize") + SPARE
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    print(json.dumps({"ready": True}), file=answers)
    for line in sys.stdin:
        order = line.strip()
        data = Path(order[5:]).read_bytes() if order.startswith("FILE ") else target.case(int(order), seeds)
        print(json.dumps(_measured(folder, target.read, file, data)), file=answers)


if __name__ == "__main__":
    main()
