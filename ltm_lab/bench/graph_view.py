"""The live view in the graph's load test: somebody who looks on, and what memory the view takes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from ltm_lab.bench.growth import Sample
from ltm_lab.bench.ports import free_ports
from ltm_ros.viewer.server import RerunProcess, grpc_url

VIEWER = "viewer"
SERVER = "viewer's server"


class Onlooker:
    """A live view's ports, and a client that takes all that its server sends, as a page in a browser does.

    It looks on from entering to leaving, and keeps nothing: what a browser holds is bounded by the browser.
    """

    def __init__(self) -> None:
        web, grpc = free_ports(2)
        self.parameters = {"serve": True, "web_port": web, "grpc_port": grpc}

    def __enter__(self) -> Self:
        self._client = RerunProcess(["--save", os.devnull, grpc_url(self.parameters["grpc_port"])])
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._client.stop()

    @property
    def bytes_taken(self) -> int:
        """That it has passed on so far; 0 where it is gone."""
        with contextlib.suppress(OSError):
            counts = dict(line.split(": ") for line in Path(f"/proc/{self._client.pid}/io").read_text().splitlines())
            return int(counts["wchar"])
        return 0


def with_server(processes: Mapping[str, int]) -> dict[str, int]:
    """These process ids by label, and that of the server which the viewer among them has started."""
    found = dict(processes)
    with contextlib.suppress(OSError, KeyError):
        for task in Path(f"/proc/{processes[VIEWER]}/task").iterdir():
            for child in (task / "children").read_text().split():
                found[SERVER] = int(child)
    return found


@dataclass(frozen=True)
class ViewResult:
    """Memory of the live view, viewer and server together, MB (PSS)."""

    most_mb: float
    last_mb: float
    server_most_mb: float
    course: list[tuple[float, float]]
    """Seconds since the beginning, MB."""
    taken_mb: float
    """That the client who looked on was sent."""

    @classmethod
    def of(cls, samples: list[Sample], taken: int) -> ViewResult:
        """`taken`: bytes. One sample with the viewer in it or more."""
        seen = [sample for sample in samples if VIEWER in sample.usage]

        def mb(sample: Sample, *labels: str) -> float:
            return sum(sample.usage[label].pss for label in labels if label in sample.usage) * 1024 / 1e6

        course = [(sample.seconds, mb(sample, VIEWER, SERVER)) for sample in seen]
        together = [held for _, held in course]
        return cls(max(together), together[-1], max(mb(s, SERVER) for s in seen), course, taken / 1e6)
