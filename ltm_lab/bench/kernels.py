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
DEM = "bags/demo/dem.tif"
POSE = """pose: {x: 348000, y: 3785000, crs: "EPSG:32611", height_above_ground: 25, azimuth_deg: 60, pitch_deg: -5}
calibration: {width: 1920, height: 1080, hfov_deg: 60}
"""
_TRACE = """
import sys, time
from ltm_ros.cli.main import cli, run_command_line
sys.modules["coverage"] = None  # numba loads it where it is installed: beside tests, not on a tower
spent = loading = 0.0
def measured():
    from ltm_core.base.kernels import _KernelCache
    from ltm_core.tracing.tracer import TerrainTracer
    trace, load = TerrainTracer.trace, _KernelCache.load_overload
    def timed(*given):
        global spent, loading
        begun, loading = time.process_time(), 0.0
        traced = trace(*given)
        spent += time.process_time() - begun - loading
        return traced
    def timed_loading(*given):
        global loading
        begun = time.process_time()
        loaded = load(*given)
        loading += time.process_time() - begun
        return loaded
    TerrainTracer.trace, _KernelCache.load_overload = timed, timed_loading
    cli()
try:
    run_command_line(measured, "ltm", {})
finally:
    print(spent)
"""


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


class TraceCost(NamedTuple):
    """Processor time of `ltm trace` in seconds. `traced_s`: of it, the time in the tracer, without that to load
    compiled kernels."""

    whole_s: float
    traced_s: float


def trace_command_costs(runs: int) -> list[TraceCost]:
    """Run `ltm trace` on the demo's DEM at 1080p `runs` times, each in a process of its own: the first with an empty
    cache of kernels, the others with the product's own, which the second may fill."""
    with tempfile.TemporaryDirectory() as name:
        pose = Path(name) / "pose.yaml"
        pose.write_text(POSE)
        arguments = ["--dem", str(project_path(DEM)), "--pose", str(pose), "--out", name, "--overwrite"]
        costs = []
        for run in range(runs):
            before = os.times()
            ran = subprocess.run(
                [sys.executable, "-c", _TRACE, "trace", *arguments],
                env=os.environ | ({} if run else {"NUMBA_CACHE_DIR": f"{name}/cache"}),
                stdout=subprocess.PIPE,
                text=True,
                check=True,
            )
            spent = [now - then for now, then in zip(os.times()[2:4], before[2:4], strict=True)]
            costs.append(TraceCost(sum(spent), float(ran.stdout.splitlines()[-1])))
        return costs


def main() -> None:
    """Compile the kinds in the arguments; print name and seconds of each kernel as JSON."""
    site = load_site(Path(project_path(SITE)))
    event.register("numba:compile", listener := _Listener())
    for kind in sys.argv[1:]:
        compile_kernels(kind, site)
    print(json.dumps(listener.found))


if __name__ == "__main__":
    main()
