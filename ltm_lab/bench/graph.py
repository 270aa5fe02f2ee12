"""Load test of a whole site graph with the demo's frames, through real DDS.

Measures how many frames are finished and how many are shed, the latency to the fuel map, processor time by job, memory
by process, and the cost of an idle graph.
"""

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
from ltm_core.raster.dem import prepare_heights
from ltm_core.site.site_io import load_site
from ltm_lab.bench.graph_cameras import CameraSender, Listener
from ltm_lab.bench.graph_site import NAME, Load, write_site
from ltm_lab.bench.process_usage import Usage, usage_of
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.ros_environment import apply_to_process

READY_S = 300.0
WARM_UP = 2
"""Frames of each camera that are not counted: networks take longer for their first."""
IDLE_S = 5.0
"""Seconds without frames over which the idle cost is measured."""

Summaries = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class GraphResult:
    """One run. Counts are frames of all cameras; latencies are seconds from the stamp to `fuel_map/update`."""

    cameras: int
    processes: str
    """Layout: `site` or `node`."""
    fusion: bool
    patrol: bool
    """Whether the cameras turn."""
    dem_cells: int
    offered_hz: float
    """Frames per second of each camera."""
    seconds: float
    offered: int
    admitted: int
    """Frames that `capture` passed on."""
    shed: int
    """Frames that `capture` dropped because the graph was busy."""
    finished: int
    """Frames with all results: votes stored in the map and, if the site fuses, depth fused with labels."""
    unlabelled: int
    """Frames fused without labels."""
    voted: int
    stored: int
    """Frames that updated the map."""
    least_finished: int
    """Finished frames of the camera with the fewest."""
    latency_p50_s: float
    latency_p95_s: float
    latency_p99_s: float
    cpu_ms_a_frame: dict[str, float]
    """Processor time per finished frame, by job and in total as `all`; starting is not included. The overhead of a
    process that nodes share is listed under the name of the process."""
    idle_cpu_ms_s: float
    """Processor time of all processes per second without frames, ms."""
    pss_mb: dict[str, float]
    """Memory after the run by process, of the cameras' nodes as `cameras`, and in total as `all`."""
    ready_s: float
    """Seconds from the start until every node had reported."""
    load_average: float
    """Load average of the machine before the run, over one minute."""
    cameras_late_s: float
    """Largest delay of the sending process."""

    @property
    def lost(self) -> int:
        """Frames that were neither finished nor shed."""
        return self.offered - self.finished - self.shed

    def as_dict(self) -> dict[str, Any]:
        """Return all figures, for JSON."""
        return asdict(self) | {"lost": self.lost}


def run_graph(load: Load, rate: float, seconds: float, domain_id: int | None = None) -> GraphResult:
    """Run the graph of `load` while each camera sends `rate` frames per second for `seconds`.

    Raises LtmError if the graph does not start or a process of it dies.
    """
    apply_to_process(domain_id)
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as name:
        folder = Path(name)
        traffic = write_site(folder, project_path("bags/demo"), load)
        site = load_site(traffic.site)
        prepare_heights(site.dem.path)  # as `ltm run` does
        graph = describe(site, traffic.site, parameters={"fuel_map": {"folder": str(folder / "kept")}})
        runner = Runner(graph, domain_id=domain_id, console=lambda line: None)
        with runner, Listener() as listener:
            started = time.monotonic()
            runner.wait_until_ready(READY_S)
            ready_s = time.monotonic() - started
            with CameraSender(folder, traffic.cameras) as sender:
                listener.settle(sender.stream(WARM_UP, 2.0 * load.cameras).all_stamps)
                idle_ms_s, busy = _idle_cpu_ms_s(runner), os.getloadavg()[0]
                before, used = dict(listener.summaries), _usage(runner)
                sent = sender.stream(max(1, round(seconds * rate)), 1.0 / rate)
                listener.settle(sent.all_stamps)
                after, used_after = dict(listener.summaries), _usage(runner)
            if restarted := [label for label, process in runner.processes.items() if process.starts > 1]:
                raise LtmError(
                    f"{', '.join(restarted)} died and restarted during the run; repeat it on a quiet machine"
                )
        spent = {label: use.cpu_s - used[label].cpu_s for label, use in used_after.items()}
        counts, latency = _counts(load.fusion, sent.stamps, listener.arrived, before, after)
        p50, p95, p99 = (float(value) for value in np.percentile(latency or [np.nan], (50, 95, 99)))
        by_job = _cpu_by_job(graph, spent, before, after)
        per_frame = {job: 1000 * cpu_s / max(counts["finished"], 1) for job, cpu_s in by_job.items()}
        return GraphResult(
            cameras=load.cameras,
            processes=site.processes,
            fusion=load.fusion,
            patrol=load.patrol,
            dem_cells=site.open_dem().elevation.size,
            offered_hz=rate,
            seconds=seconds,
            latency_p50_s=p50,
            latency_p95_s=p95,
            latency_p99_s=p99,
            cpu_ms_a_frame=per_frame | {"all": sum(per_frame.values())},
            idle_cpu_ms_s=idle_ms_s,
            pss_mb=_pss_mb(used_after),
            ready_s=ready_s,
            load_average=busy,
            cameras_late_s=sent.late_s,
            **counts,
        )


def _counts(
    fusion: bool, sent: Mapping[str, list[int]], arrived: Mapping[int, float], before: Summaries, after: Summaries
) -> tuple[dict[str, int], list[float]]:
    """Return the counts of a result by field, and the latency of each frame in the map, s."""

    def counted(camera: str, node: str, key: str) -> int:
        name = f"/{NAME}/{camera}/{node}"
        return int(after.get(name, {}).get(key, "0")) - int(before.get(name, {}).get(key, "0"))

    total: Counter[str] = Counter()
    finished = []
    for camera, stamps in sent.items():
        stored = sum(stamp in arrived for stamp in stamps)
        fused, unlabelled = (counted(camera, "topodepth", key) for key in ("frames_out", "noted.unlabelled"))
        total.update(
            offered=len(stamps),
            admitted=counted(camera, "capture", "frames_out"),
            shed=counted(camera, "capture", "dropped.shed"),
            voted=counted(camera, "fuel_votes", "frames_out"),
            unlabelled=unlabelled,
            stored=stored,
        )
        finished.append(min(stored, fused - unlabelled) if fusion else stored)
    latency = [arrived[stamp] - stamp / 1e9 for stamps in sent.values() for stamp in stamps if stamp in arrived]
    return dict(total) | {"finished": sum(finished), "least_finished": min(finished)}, latency


def _cpu_by_job(graph: Graph, spent: Mapping[str, float], before: Summaries, after: Summaries) -> dict[str, float]:
    """Return processor seconds by type of node: as reported by nodes that share a process, whose rest is listed by
    label."""
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
    before, since = _usage(runner), time.monotonic()
    time.sleep(IDLE_S)
    used = sum(use.cpu_s for use in _usage(runner).values()) - sum(use.cpu_s for use in before.values())
    return 1000 * used / (time.monotonic() - since)


def _usage(runner: Runner) -> dict[str, Usage]:
    return usage_of({label: process.pid for label, process in runner.processes.items() if process.pid})


def _pss_mb(found: Mapping[str, Usage]) -> dict[str, float]:
    by_process: defaultdict[str, float] = defaultdict(float)
    for label, use in found.items():
        by_process["cameras" if "/" in label else label] += use.pss * 1024 / 1e6
    return dict(by_process) | {"all": sum(by_process.values())}
