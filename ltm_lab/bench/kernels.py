"""Measure the processor time that the kernels of each kind of node take to compile."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from numba.core import event

from ltm_core.base.resources import project_path
from ltm_core.pipeline.kernels import compile_kernels
from ltm_core.site.site_io import load_site

SITE = "bags/demo/site.yaml"


class CompiledKernel(NamedTuple):
    """A kernel, or a function of numba that kernels use. `own_s`: processor time in seconds without that of the
    functions that it calls. `signatures`: number of combinations of types."""

    name: str
    own_s: float
    signatures: int


class _Listener(event.Listener):  # type: ignore[misc]
    def __init__(self) -> None:
        self.found: list[tuple[str, float]] = []
        self._open: list[list[float]] = []

    def on_start(self, event: Any) -> None:
        self._open.append([time.thread_time(), 0.0])

    def on_end(self, event: Any) -> None:
        begun, called = self._open.pop()
        spent = time.thread_time() - begun
        if self._open:
            self._open[-1][1] += spent
        function = event.data["dispatcher"].py_func
        self.found.append((f"{function.__module__}.{function.__qualname__}", spent - called))


def compile_times(kinds: Iterable[str]) -> list[CompiledKernel]:
    """Compile the kernels of kinds of nodes in a process of their own, with an empty cache; the slowest first."""
    with tempfile.TemporaryDirectory() as cache:
        ran = subprocess.run(
            [sys.executable, "-m", __name__, *kinds],
            env=os.environ | {"NUMBA_CACHE_DIR": cache},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    times: dict[str, list[float]] = {}
    for name, spent in json.loads(ran.stdout.splitlines()[-1]):
        times.setdefault(name, []).append(spent)
    return sorted(
        (CompiledKernel(name, sum(spent), len(spent)) for name, spent in times.items()), key=lambda row: -row.own_s
    )


def main() -> None:
    """Compile the kinds in the arguments; print name and seconds of each kernel as JSON."""
    site = load_site(Path(project_path(SITE)))
    event.register("numba:compile", listener := _Listener())
    for kind in sys.argv[1:]:
        compile_kernels(kind, site)
    print(json.dumps(listener.found))


if __name__ == "__main__":
    main()
