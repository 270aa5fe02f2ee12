"""`ltm-lab bench graph`: load test of a site's whole graph with the demo's frames, through real DDS.

Measures how many frames are finished, how many are shed, the latency to the fuel map, processor time by job, memory by
process, and what the graph costs while nothing comes.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.base.resources import project_path
from ltm_core.raster.dem_io import prepare_heights
from ltm_core.site.site_io import load_site
from ltm_lab.bench.graph_sender import CameraSender, settle
from ltm_lab.bench.graph_site import NAME, Load, write_site
from ltm_lab.bench.graph_view import Onlooker, ViewResult, with_server
from ltm_lab.bench.growth import GrowthWatch, HeldMore
from ltm_lab.bench.listener import Listener
from ltm_lab.bench.process_usage import Usage, usage_of
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.watchdog import process_use
from ltm_ros.runtime.ros_environment import apply_to_process

READY_S = 300.0
WARM_UP = 2
"""Frames of each camera before any is counted: networks take longer for their first."""
SAMPLES = 60
"""Of memory, descriptors and files in a run."""
IDLE_S = 5.0
"""For which it is measured what the graph takes while nothing comes."""

Summaries = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class GraphResult:
    """One run. Counts are of frames of all cameras; latencies in seconds, from the stamp to `fuel_map/update`."""

    cameras: int
    processes: str
    """Layout: `site` or `node`."""
    fusion: bool
    width: int
    """Of the photos, pixels."""
    patrol: bool
    """Whether the cameras turn."""
    dem_cells: int
    offered_hz: float
    """Of each camera."""
    seconds: float
    offered: int
    admitted: int
    """That `capture` sent on."""
    shed: int
    """That `capture` turned away at the door."""
    finished: int
    """That had everything: labels and depth made one where the site fuses, and votes, stored in the map."""
    fused: int
    unlabelled: int
    """Fused without labels."""
    voted: int
    stored: int
    """That the map told of."""
    least_finished: int
    """Of the camera that had the fewest."""
    latency_p50_s: float
    latency_p95_s: float
    latency_p99_s: float
    latency_max_s: float
    fused_p50_s: float | None
    """From the stamp to `fused/depth`, of the slowest camera, its first frames among them; None without
    fusion."""
    fused_p95_s: float | None
    cpu_ms_a_frame: dict[str, float]
    """Processor time by job and in `all`, over the frames that were finished; of starting nothing is in it. What a
    process that nodes share takes besides their work stands under its own name."""
    idle_cpu_ms_s: float
    """Processor time of all processes, before the run, while nothing came: ms a second."""
    pss_mb: dict[str, float]
    """Memory after the run by process, of the cameras' nodes in sum, and in `all`; shared pages are counted once."""
    grown_pss_mb: float
    """Of all processes, from before the run, after the first frames of each camera, to its end; so the next two."""
    grown_descriptors: int
    grown_threads: int
    held_more: HeldMore
    """At the end of the run than at its middle."""
    seen_cells: tuple[int, int]
    """Cells of the map that frames have touched, before the run and after: what its files hold."""
    view: ViewResult | None
    """Of the live view, where there is one."""
    ready_s: float
    """From the start until every node had reported."""
    load_average: float
    """Of the minute before the run: what else the machine had to do."""
    cameras_late_s: float
    """The most by which the sending process fell behind its own plan."""

    @property
    def lost(self) -> int:
        """Neither finished nor shed."""
        return self.offered - self.finished - self.shed

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self) | {"lost": self.lost}


def run_graph(
    load: Load, rate: float, seconds: float, domain_id: int | None = None, onlooker: Onlooker | None = None
) -> GraphResult:
    """The graph of `load`, each of whose cameras sends `rate` frames a second for `seconds`; with a live view that
    `onlooker` looks at. Raises LtmError where it does not run."""
    apply_to_process(domain_id)
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as name:
        folder = Path(name)
        traffic = write_site(folder, project_path("bags/demo"), load)
        site = load_site(traffic.site)
        prepare_heights(site.dem.path)  # as `ltm run` does
        kept = {"fuel_map": {"folder": str(folder / "kept")}}
        graph = describe(site, traffic.site, parameters=kept, view=onlooker.parameters if onlooker else None)
        runner = Runner(graph, domain_id=domain_id, log_folder=folder / "log", console=lambda line: None)
        with runner, Listener(NAME) as listener:
            started = time.monotonic()
            runner.wait_until_ready(READY_S)
            ready_s = time.monotonic() - started
            looking = onlooker or contextlib.nullcontext()
            with CameraSender(folder, traffic.cameras, domain_id) as sender, looking:
                settle(listener, sender.stream(WARM_UP, 2.0 * load.cameras).stamps)
                idle_ms_s, at_first = _idle_cpu_ms_s(runner), _usage(runner)
                busy = os.getloadavg()[0]
                before, cpu = dict(listener.summaries), _cpu_by_process(runner)
                with GrowthWatch(lambda: _running(runner), folder / "kept", seconds / SAMPLES) as watch:
                    report = sender.stream(max(1, round(seconds * rate)), 1.0 / rate)
                settle(listener, report.stamps)
                after, cpu_after = dict(listener.summaries), _cpu_by_process(runner)
                at_last = _usage(runner)
                taken = onlooker.bytes_taken if onlooker else 0
            restarted = [label for label, process in runner.processes.items() if process.starts > 1]
            if restarted:
                raise LtmError(f"died and were started again: {', '.join(restarted)}")
            spent = {process: cpu_after[process] - cpu[process] for process in cpu}
            measured = {
                "offered_hz": rate,
                "seconds": seconds,
                "width": load.width,
                "patrol": load.patrol,
                "dem_cells": site.open_dem().elevation.size,
                "processes": site.processes,
                "idle_cpu_ms_s": idle_ms_s,
                "pss_mb": _pss_mb(at_last),
                "grown_pss_mb": _pss_mb(at_last)["all"] - _pss_mb(at_first)["all"],
                "grown_descriptors": _total(at_last, "descriptors") - _total(at_first, "descriptors"),
                "grown_threads": _total(at_last, "threads") - _total(at_first, "threads"),
                "held_more": HeldMore.of(watch.samples),
                "seen_cells": (_seen_cells(before), _seen_cells(after)),
                "view": ViewResult.of(watch.samples, taken) if onlooker else None,
                "ready_s": ready_s,
                "load_average": busy,
                "cameras_late_s": report.late_s,
            }
            jobs = _cpu_by_job(graph, spent, before, after)
            return _result(load.fusion, report.sent, listener.arrived, before, after, jobs, measured)


def _result(
    fusion: bool,
    sent: Mapping[str, list[int]],
    arrived: Mapping[int, float],
    before: Summaries,
    after: Summaries,
    cpu_s: Mapping[str, float],
    measured: Mapping[str, Any],
) -> GraphResult:
    def counted(camera: str, node: str, key: str) -> int:
        name = f"/{NAME}/{camera}/{node}"
        return int(after.get(name, {}).get(key, "0")) - int(before.get(name, {}).get(key, "0"))

    def fused_latency(key: str) -> float | None:
        if not fusion:
            return None
        said = [float(after.get(f"/{NAME}/{camera}/topodepth", {}).get(key, "nan")) for camera in sent]
        return max(said) / 1000

    total: Counter[str] = Counter()
    finished = []
    for camera, stamps in sent.items():
        told = sum(stamp in arrived for stamp in stamps)
        fused, unlabelled = (counted(camera, "topodepth", key) for key in ("frames_out", "noted.unlabelled"))
        total.update(
            offered=len(stamps),
            admitted=counted(camera, "capture", "frames_out"),
            shed=counted(camera, "capture", "dropped.shed"),
            voted=counted(camera, "fuel_votes", "frames_out"),
            fused=fused,
            unlabelled=unlabelled,
            stored=told,
        )
        finished.append(min(told, fused - unlabelled) if fusion else told)
    ages = [arrived[stamp] - stamp / 1e9 for stamps in sent.values() for stamp in stamps if stamp in arrived]
    p50, p95, p99, most = np.percentile(ages or [np.nan], (50, 95, 99, 100))
    per_frame = {job: 1000 * spent / max(sum(finished), 1) for job, spent in cpu_s.items()}
    return GraphResult(
        cameras=len(sent),
        fusion=fusion,
        finished=sum(finished),
        least_finished=min(finished),
        latency_p50_s=float(p50),
        latency_p95_s=float(p95),
        latency_p99_s=float(p99),
        latency_max_s=float(most),
        fused_p50_s=fused_latency("latency_p50_ms"),
        fused_p95_s=fused_latency("latency_p95_ms"),
        cpu_ms_a_frame=per_frame | {"all": sum(per_frame.values())},
        **dict(measured) | total,
    )


def _cpu_by_process(runner: Runner) -> dict[str, float]:
    """Processor seconds so far, by label."""
    return {label: process_use(process.pid).cpu_s for label, process in runner.processes.items() if process.pid}


def _cpu_by_job(graph: Graph, spent: Mapping[str, float], before: Summaries, after: Summaries) -> dict[str, float]:
    """Processor seconds by type of node; of a shared process as its nodes state them, the rest under its label."""
    jobs: defaultdict[str, float] = defaultdict(float)
    for process in graph.processes:
        rest = spent[process.label]
        for node in process.nodes if process.shared else ():
            stated = [float(said.get(node.full_name, {}).get("cpu_s", "0")) for said in (before, after)]
            jobs[node.name] += stated[1] - stated[0]
            rest -= stated[1] - stated[0]
        jobs[process.label if process.shared else process.nodes[0].name] += rest
    return dict(jobs)


def _idle_cpu_ms_s(runner: Runner) -> float:
    before, since = _cpu_by_process(runner), time.monotonic()
    time.sleep(IDLE_S)
    used = sum(_cpu_by_process(runner).values()) - sum(before.values())
    return 1000 * used / (time.monotonic() - since)


def _usage(runner: Runner) -> dict[str, Usage]:
    return usage_of(_running(runner))


def _running(runner: Runner) -> dict[str, int]:
    return with_server({label: process.pid for label, process in runner.processes.items() if process.pid})


def _seen_cells(said: Summaries) -> int:
    return int(float(said.get(f"/{NAME}/fuel_map", {}).get("cells.seen", "0")))


def _total(found: Mapping[str, Usage], what: str) -> int:
    return sum(getattr(use, what) for use in found.values())


def _pss_mb(found: Mapping[str, Usage]) -> dict[str, float]:
    by_process: defaultdict[str, float] = defaultdict(float)
    for label, use in found.items():
        by_process["cameras" if "/" in label else label] += use.pss * 1024 / 1e6
    return dict(by_process) | {"all": sum(by_process.values())}
