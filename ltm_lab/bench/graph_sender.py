"""Has simulated cameras send into a graph under test, and waits until it has done its work."""

from __future__ import annotations

import json
import subprocess  # nosec B404 # argument lists, no shell
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from ltm_core.base.errors import LtmError
from ltm_lab.bench.listener import Listener
from ltm_ros.runtime.ros_environment import ros_environment

QUIET_S = 6.0
"""Without any update of the map, after which no more will come."""
LONGEST_SETTLE_S = 60.0


@dataclass(frozen=True)
class Sent:
    """Stamps by camera, ns; `late_s`: the most by which the sending process fell behind its plan."""

    sent: dict[str, list[int]]
    late_s: float

    @property
    def stamps(self) -> set[int]:
        """Of all cameras."""
        return {stamp for stamps in self.sent.values() for stamp in stamps}


class CameraSender:
    """The process that sends for all cameras of `folder` (`write_site`), from when they are listened to until this
    context ends. Raises LtmError where no graph listens."""

    def __init__(self, folder: Path, cameras: Sequence[str], domain_id: int | None) -> None:
        self.cameras = len(cameras)
        self._process = subprocess.Popen(  # nosec B603 # no shell, no argument from the wire
            [sys.executable, "-m", "ltm_lab.bench.graph_cameras", str(folder), *cameras],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=ros_environment(domain_id=domain_id, busy=False),
        )
        assert self._process.stdin is not None  # nosec B101 # tells the type checker what holds
        assert self._process.stdout is not None  # nosec B101 # tells the type checker what holds
        self._orders, self._reports = self._process.stdin, self._process.stdout

    def __enter__(self) -> Self:
        if self._reports.readline().strip() != "ready":
            self._process.communicate(timeout=30)
            raise LtmError("the cameras of the benchmark found no graph that listens")
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate(timeout=30)

    def stream(self, frames: int, period_s: float) -> Sent:
        """Have every camera send so many frames, `period_s` apart; returns when all are sent."""
        self._orders.write(json.dumps({"frames": frames, "period": period_s, "begin": time.time() + 0.5}) + "\n")
        self._orders.flush()
        report = json.loads(self._reports.readline())
        return Sent(report["sent"], report["late"])


def settle(listener: Listener, stamps: set[int]) -> None:
    """Until the map has told of all these frames, or of none for a while; then until diagnostics say so too."""
    deadline, last, since = time.monotonic() + LONGEST_SETTLE_S, -1, time.monotonic()
    while (told := len(stamps & listener.arrived.keys())) < len(stamps) and time.monotonic() < deadline:
        if told != last:
            last, since = told, time.monotonic()
        if time.monotonic() - since > QUIET_S:
            break
        time.sleep(0.1)
    time.sleep(2.2)  # diagnostics come once a second
