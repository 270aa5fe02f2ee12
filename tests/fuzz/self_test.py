"""A reader that fails in every way that the suite must notice."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np

from fuzz.target import Target
from ltm_core.base.errors import ConfigError

_IMPORTED_BY = os.getpid()


def _ways_to_fail(folder: Path) -> None:
    order = (folder / "order").read_bytes()
    if order == b"kill":
        os.kill(os.getpid(), signal.SIGSEGV)
    if order == b"grow":
        np.ones(600 << 20, np.uint8)
    if order == b"bug":
        raise KeyError("not ours")
    if order == b"hang":
        signal.pause()
    if order == b"think":
        until = time.process_time() + 0.2
        while time.process_time() < until:
            pass
    if order == b"imports" and os.getpid() == _IMPORTED_BY:
        raise ImportError("made by this process, not by the one that it was forked from")
    if order == b"ours":
        raise ConfigError("ours")


SELF_TEST = Target("self_test", "order", lambda folder: [b"whole"], _ways_to_fail)
