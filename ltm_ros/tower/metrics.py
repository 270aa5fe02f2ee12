"""Export a tower's state as metrics in Prometheus's text format."""

from collections.abc import Iterable

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ltm_ros.runtime.health import CameraState
from ltm_ros.tower.tower_status import OUTBOX_KEYS, TowerStatus

METRICS_KIND = "text/plain; version=0.0.4; charset=utf-8"
NUMBERS = {
    "frames_in": ("ltm_frames_in_total", "Frames received"),
    "frames_out": ("ltm_frames_out_total", "Frames with a published result"),
    "received": ("ltm_received_total", "Messages received"),
    "published": ("ltm_published_total", "Messages published"),
    "rate_hz": ("ltm_rate_hertz", "Messages published per second"),
    "cpu_s": ("ltm_cpu_seconds_total", "Processor time of a node that shares a process"),
}
BY_KIND = {
    "dropped": ("cause", "Inputs dropped, by cause; `shed`: rejected on arrival"),
    "noted": ("event", "Events, by name"),
}
QUANTILES = {"0.5": "p50", "0.95": "p95"}
TIMES = {"latency": "Time from a frame's stamp to a result", "work": "Processing time of one message"}
OWN = {"dropped", "newest_stamp", *OUTBOX_KEYS}
"""Keys of `/diagnostics` that other metrics show; other numbers are exported as `ltm_node_value`."""


class TowerCollector(Collector):
    """Metrics of one state; create a new one for each scrape."""

    def __init__(self, status: TowerStatus) -> None:
        self._families: dict[str, CounterMetricFamily | GaugeMetricFamily] = {}
        versions = {name.replace("-", "_"): version for name, version in status.machine.versions.items()}
        self._add("ltm_build_info", "Versions of the running software", 1, site=status.site, **versions)
        self._add("ltm_alive", "Whether every node reports (/healthz)", status.alive)
        self._add("ltm_ready", "Whether every node reports and every camera sends (/readyz)", status.ready)
        self._add("ltm_wrong", "Number of current problems", len(status.wrong))
        for one in status.conditions:
            problem = bool(one.problem)
            self._add("ltm_problem", "Whether something has a problem", problem, kind=one.kind, name=one.name)
        self._cameras(status)
        self._nodes(status)
        self._outbox_and_machine(status)

    def collect(self) -> Iterable[Metric]:
        return self._families.values()

    def _add(self, name: str, text: str, value: float, /, **labels: str) -> None:
        """Add a sample; the name of a counter ends in `_total`."""
        if name not in self._families:
            kind = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
            self._families[name] = kind(name, text, labels=tuple(labels))
        self._families[name].add_metric(tuple(labels.values()), value)

    def _cameras(self, status: TowerStatus) -> None:
        for one in status.cameras:
            for state in CameraState:
                of = {"camera": one.name, "state": state.value}
                self._add("ltm_camera_state", "Whether a camera is in a state", one.state is state, **of)
            since = "ltm_camera_state_since_timestamp_seconds"
            self._add(since, "Start of a camera's state", one.since_s, camera=one.name)
            if one.frame_age_s is not None:
                self._add("ltm_frame_age_seconds", "Age of the newest frame", one.frame_age_s, camera=one.name)
            self._add("ltm_frames_finished_total", "Frames processed to fuel votes", one.finished, camera=one.name)
        # No counter: without subscribers only some frames are judged, and more of them while the verdict is not ok.
        for node in status.nodes:
            for verdict in node.counts("noted.verdict."):
                last, of = node.values.get("verdict") == verdict, {"camera": node.camera, "verdict": verdict}
                self._add("ltm_fusion_verdict", "Whether this is the last verdict on depth", last, **of)

    def _nodes(self, status: TowerStatus) -> None:
        for node in status.nodes:
            of = {"node": node.name, "camera": node.camera}
            self._add("ltm_node_up", "Whether a node reports", node.state in ("ok", "warning"), **of)
            warns = node.state == "warning"
            self._add("ltm_node_warning", "Whether it dropped something in the last 10 s", warns, **of)
            for kind, (label, text) in BY_KIND.items():
                for name, count in node.counts(f"{kind}.").items():
                    self._add(f"ltm_{kind}_total", text, count, **of, **{label: name})
            for name, text in TIMES.items():
                for quantile, suffix in QUANTILES.items():
                    if (number := node.number(f"{name}_{suffix}_ms")) is not None:
                        self._add(f"ltm_{name}_seconds", text, number / 1000, **of, quantile=quantile)
            for key in node.values:
                if (number := node.number(key)) is None:
                    continue
                if key in NUMBERS:
                    self._add(*NUMBERS[key], number, **of)
                elif key not in OWN and not key.startswith(("dropped.", "noted.", "reason.", "latency_", "work_")):
                    self._add("ltm_node_value", "Other numbers that a node reports", number, **of, name=key)

    def _outbox_and_machine(self, status: TowerStatus) -> None:
        machine, clock = status.machine, status.machine.clock
        if (outbox := status.outbox) is not None:
            self._add("ltm_outbox_frames", "Frames queued for the region's map", outbox.frames)
            self._add("ltm_outbox_bytes", "Size of their votes", outbox.bytes)
            self._add("ltm_outbox_age_seconds", "Age of the oldest queued frame", outbox.age_s)
            self._add("ltm_link_up", "Whether the region's map is connected", outbox.link_up)
        if clock.synchronised is not None:
            self._add("ltm_clock_synchronised", "Whether the system clock is synchronised", clock.synchronised)
        if clock.estimated_error_s is not None:
            self._add("ltm_clock_error_seconds", "Clock error as the kernel estimates it", clock.estimated_error_s)
        for disk in machine.disks:
            if disk.total >= 0:
                self._add("ltm_disk_free_bytes", "Free space of a storage folder", disk.free, folder=disk.folder)
                self._add("ltm_disk_bytes", "Size of that file system", disk.total, folder=disk.folder)
        self._add("ltm_memory_bytes", "Total memory of the machine", machine.memory_total)
        self._add("ltm_memory_available_bytes", "Available memory of the machine", machine.memory_available)


def exposition(status: TowerStatus) -> bytes:
    """Return the answer to a scrape."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(TowerCollector(status))
    return bytes(generate_latest(registry))
