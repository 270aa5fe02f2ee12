"""`ltm-lab bench network`: load test of one fuel map node with the votes of many towers, through real DDS.

Measures frames a second, latency, processor time, memory and the store.
"""

from __future__ import annotations

import json
import os
import subprocess  # nosec B404 # argument lists, no shell
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.base.resources import config_path
from ltm_core.pipeline.stored_fuel import STORE_FILE
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_lab.bench.listener import Listener
from ltm_lab.bench.network_site import NAME, Traffic, write_region
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.watchdog import process_use
from ltm_ros.runtime.ros_environment import apply_to_process, ros_environment

TOWERS_A_PROCESS = 25
SETTLE_S = 20.0


@dataclass(frozen=True)
class NetworkResult:
    """One run. Frames: `sent` by all towers, `told` of by an update, `stored` on disk at the end. Rates in Hz."""

    towers: int
    offered_hz: float
    sustained_hz: float
    sent: int
    told: int
    stored: int
    dropped: dict[str, int]
    latency_p50_s: float
    latency_p95_s: float
    latency_max_s: float
    cpu_cores: float
    """Processor seconds of the aggregator a second."""
    cpu_ms_a_frame: float
    memory_mb: float
    store_mb: float
    open_s: float
    """To open the store and have the map again, after a kill."""
    cells_a_frame: float
    bytes_a_frame: float
    towers_late_s: float
    """The most by which a tower's process fell behind its own plan."""

    @property
    def lost(self) -> int:
        return self.sent - min(self.told, self.stored)


def run_network(
    towers: int, rate: float, seconds: float, extent: float, views: int, domain_id: int | None = None
) -> NetworkResult:
    """One aggregator with `towers` that together send `rate` frames a second. Raises LtmError where it does not run."""
    apply_to_process(domain_id)
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as name:
        folder = Path(name)
        traffic = write_region(folder, towers, extent, views)
        for tower, pool in traffic.messages.items():
            for number, cdr in enumerate(pool):
                (folder / f"{tower}.{number:03d}.cdr").write_bytes(cdr)
        return _run(folder, traffic, towers, rate, seconds, domain_id)


def _run(
    folder: Path, traffic: Traffic, towers: int, rate: float, seconds: float, domain_id: int | None
) -> NetworkResult:
    whole = describe(load_site(traffic.site), traffic.site, parameters={"fuel_map": {"folder": str(folder / "kept")}})
    graph = Graph(NAME, (whole.node("fuel_map"),))
    runner = Runner(graph, domain_id=domain_id, log_folder=folder / "log", console=lambda line: None)
    with runner, Listener(NAME) as listener:
        runner.wait_until_ready(120.0)
        pid = runner.processes["fuel_map"].pid or 0
        with _towers(folder, list(traffic.messages), rate, seconds, domain_id) as senders:
            before = process_use(pid).cpu_s
            begin = time.time() + 1.0
            for sender in senders:
                _tell(sender, {"begin": begin})
            reports = [json.loads(_line(sender)) for sender in senders]
            sent = [stamp for report in reports for stamp in report["sent"]]
            deadline = time.monotonic() + SETTLE_S
            while len(listener.arrived.keys() & set(sent)) < len(sent) and time.monotonic() < deadline:
                time.sleep(0.1)
            cpu, memory = process_use(pid).cpu_s - before, _resident_mb(pid)
        time.sleep(1.2)  # for the last diagnostics
        summary = listener.summaries.get(f"/{NAME}/fuel_map", {})
        restarts = runner.processes["fuel_map"].starts - 1
        runner.kill("fuel_map")
    if restarts:
        raise LtmError(f"the aggregator died {restarts} times; see its log: {_last_words(folder)}")
    arrived = {stamp: listener.arrived[stamp] for stamp in sent if stamp in listener.arrived}
    latency = np.array([at - stamp / 1e9 for stamp, at in arrived.items()] or [np.nan])
    span = max(arrived.values(), default=begin) - begin
    store = folder / "kept" / STORE_FILE
    size = sum(f.stat().st_size for f in store.parent.glob(f"{STORE_FILE}*"))
    stored, open_s = _opened(traffic.site, store)
    return NetworkResult(
        towers=towers,
        offered_hz=len(sent) / seconds,
        sustained_hz=len(arrived) / span if span > 0 else 0.0,
        sent=len(sent),
        told=len(arrived),
        stored=stored,
        dropped={k.partition(".")[2]: int(v) for k, v in summary.items() if k.startswith("dropped.")},
        latency_p50_s=float(np.percentile(latency, 50)),
        latency_p95_s=float(np.percentile(latency, 95)),
        latency_max_s=float(latency.max()),
        cpu_cores=cpu / span if span > 0 else 0.0,
        cpu_ms_a_frame=1000 * cpu / max(len(sent), 1),
        memory_mb=memory,
        store_mb=size / 1e6,
        open_s=open_s,
        cells_a_frame=traffic.cells,
        bytes_a_frame=traffic.bytes,
        towers_late_s=max(report["late"] for report in reports),
    )


@contextmanager
def _towers(
    folder: Path, names: list[str], rate: float, seconds: float, domain_id: int | None
) -> Iterator[list[subprocess.Popen[str]]]:
    """Processes whose towers are all listened to; they end when this does."""
    period = len(names) / rate
    senders = []
    try:
        for first in range(0, len(names), TOWERS_A_PROCESS):
            process = subprocess.Popen(  # nosec B603 # no shell, no argument from the wire
                [sys.executable, "-m", "ltm_lab.bench.network_towers", str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=ros_environment(domain_id=domain_id, busy=False),
            )
            senders.append(process)
            order = {
                "site": NAME,
                "towers": names[first : first + TOWERS_A_PROCESS],
                "first": first,
                "frames": max(1, round(seconds / period)),
                "period": period,
                "gap": 1.0 / rate,
            }
            _tell(process, order)
        for process in senders:
            if _line(process).strip() != "ready":
                raise LtmError("the towers of the benchmark found no aggregator that listens")
        yield senders
    finally:
        for process in senders:
            process.communicate("\n", timeout=30)


def _tell(process: subprocess.Popen[str], content: dict[str, Any]) -> None:
    assert process.stdin is not None  # nosec B101 # tells the type checker what holds
    process.stdin.write(json.dumps(content) + "\n")
    process.stdin.flush()


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None  # nosec B101 # tells the type checker what holds
    return process.stdout.readline()


def _opened(site_path: Path, store: Path) -> tuple[int, float]:
    """Frames in the store, and the seconds that opening it takes."""
    from ltm_core.pipeline.site_fuel import site_evidence_map
    from ltm_core.pipeline.stored_fuel import open_stored_map

    site = load_site(site_path)
    labels = LabelSet.load(config_path(site.labels))
    geometry = site.fuel_geometry(site.open_dem())
    times = []
    for _ in range(2):  # the first time compiles kernels in this process
        empty = site_evidence_map(site, geometry, labels)
        begun = time.perf_counter()
        with open_stored_map(store, site, empty) as opened:
            frames = opened.frame_count()
        times.append(time.perf_counter() - begun)
    return frames, min(times)


def _resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _last_words(folder: Path) -> str:
    return (folder / "log" / "fuel_map.log").read_text(encoding="utf-8")[-2000:]


def as_dict(result: NetworkResult) -> dict[str, Any]:
    return asdict(result) | {"lost": result.lost}
