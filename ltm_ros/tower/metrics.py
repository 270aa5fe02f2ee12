"""Export a tower's state as metrics in Prometheus's text format."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ltm_ros.runtime.health import CameraState
from ltm_ros.tower.tower_status import OUTBOX_KEYS, TowerStatus

METRICS_KIND = "text/plain; version=0.0.4; charset=utf-8"
NODE = ("node", "camera")
COUNTERS = {
    "frames_in": "Frames received",
    "frames_out": "Frames with a published result",
    "received": "Messages received",
    "published": "Messages published",
}
BY_KIND = {
    "dropped": ("cause", "Inputs dropped, by cause; `shed`: rejected on arrival"),
    "noted": ("event", "Events, by name"),
}
QUANTILES = {"0.5": "p50", "0.95": "p95"}
OWN = {"dropped", "rate_hz", "cpu_s", "newest_stamp", *COUNTERS, *OUTBOX_KEYS}
"""Keys of `/diagnostics` with metrics of their own; other numbers are exported as `ltm_node_value`."""


class TowerCollector(Collector):
    """Metrics of one state; create a new one for each scrape."""

    def __init__(self, status: TowerStatus) -> None:
        self._status = status

    def collect(self) -> Iterable[Metric]:
        yield from self._tower()
        yield from self._cameras()
        yield from self._nodes()
        yield from self._outbox()
        yield from self._machine()

    def _tower(self) -> Iterator[Metric]:
        status = self._status
        names = tuple(name.replace("-", "_") for name in status.versions)
        build = (status.site, *status.versions.values()), 1
        yield _gauge("ltm_build_info", "Versions of the running software", [build], ("site", *names))
        yield GaugeMetricFamily("ltm_alive", "Whether every node reports (/healthz)", value=status.alive)
        yield GaugeMetricFamily(
            "ltm_ready", "Whether every node reports and every camera sends (/readyz)", value=status.ready
        )
        yield GaugeMetricFamily("ltm_wrong", "Number of current problems", value=len(status.wrong))
        problems = [((one.kind, one.name), bool(one.problem)) for one in status.conditions]
        yield _gauge("ltm_problem", "Whether something has a problem", problems, ("kind", "name"))

    def _outbox(self) -> Iterator[Metric]:
        outbox = self._status.outbox
        if outbox is None:
            return
        yield GaugeMetricFamily("ltm_outbox_frames", "Frames queued for the region's map", value=outbox.frames)
        yield GaugeMetricFamily("ltm_outbox_bytes", "Size of their votes", value=outbox.bytes)
        yield GaugeMetricFamily("ltm_outbox_age_seconds", "Age of the oldest queued frame", value=outbox.age_s)
        yield GaugeMetricFamily("ltm_link_up", "Whether the region's map is connected", value=outbox.link_up)

    def _cameras(self) -> Iterator[Metric]:
        cameras = self._status.cameras
        states = [((one.name, state), one.state is state) for one in cameras for state in CameraState]
        yield _gauge("ltm_camera_state", "Whether a camera is in a state", states, ("camera", "state"))
        since = "ltm_camera_state_since_timestamp_seconds"
        yield _gauge(since, "Start of a camera's state", [((one.name,), one.since_s) for one in cameras], ("camera",))
        ages = [((one.name,), one.frame_age_s) for one in cameras if one.frame_age_s is not None]
        yield _gauge("ltm_frame_age_seconds", "Age of the newest frame", ages, ("camera",))
        finished = CounterMetricFamily("ltm_frames_finished", "Frames processed to fuel votes", labels=("camera",))
        for camera in cameras:
            finished.add_metric((camera.name,), camera.finished)
        yield finished
        # No counter: without subscribers only some frames are judged, and more of them while the verdict is not ok.
        verdicts = [
            ((node.camera, verdict), node.values.get("verdict") == verdict)
            for node in self._status.nodes
            for verdict in node.counts("noted.verdict.")
        ]
        yield _gauge("ltm_fusion_verdict", "Whether this is the last verdict on depth", verdicts, ("camera", "verdict"))

    def _nodes(self) -> Iterator[Metric]:
        up = GaugeMetricFamily("ltm_node_up", "Whether a node reports", labels=NODE)
        warning = GaugeMetricFamily("ltm_node_warning", "Whether it dropped something in the last 10 s", labels=NODE)
        counters = {key: CounterMetricFamily(f"ltm_{key}", text, labels=NODE) for key, text in COUNTERS.items()}
        kinds = {
            kind: CounterMetricFamily(f"ltm_{kind}", text, labels=(*NODE, label))
            for kind, (label, text) in BY_KIND.items()
        }
        rate = GaugeMetricFamily("ltm_rate_hertz", "Messages published per second", labels=NODE)
        cpu = CounterMetricFamily("ltm_cpu_seconds", "Processor time of a node that shares a process", labels=NODE)
        times = {
            name: GaugeMetricFamily(f"ltm_{name}_seconds", text, labels=(*NODE, "quantile"))
            for name, text in (
                ("latency", "Time from a frame's stamp to a result"),
                ("work", "Processing time of one message"),
            )
        }
        values = GaugeMetricFamily("ltm_node_value", "Other numbers that a node reports", labels=(*NODE, "name"))
        for node in self._status.nodes:
            labels = (node.name, node.camera)
            up.add_metric(labels, node.state in ("ok", "warning"))
            warning.add_metric(labels, node.state == "warning")
            for key, family in counters.items():
                if (number := node.number(key)) is not None:
                    family.add_metric(labels, number)
            for kind, family in kinds.items():
                for name, count in node.counts(f"{kind}.").items():
                    family.add_metric((*labels, name), count)
            for key, single in (("rate_hz", rate), ("cpu_s", cpu)):
                if (number := node.number(key)) is not None:
                    single.add_metric(labels, number)
            for name, gauge in times.items():
                for quantile, suffix in QUANTILES.items():
                    if (number := node.number(f"{name}_{suffix}_ms")) is not None:
                        gauge.add_metric((*labels, quantile), number / 1000)
            for key in node.values:
                if not _has_own(key) and (number := node.number(key)) is not None:
                    values.add_metric((*labels, key), number)
        yield from (up, warning, *counters.values(), *kinds.values(), rate, cpu, *times.values(), values)

    def _machine(self) -> Iterator[Metric]:
        status = self._status
        if status.clock.synchronised is not None:
            yield GaugeMetricFamily(
                "ltm_clock_synchronised", "Whether the system clock is synchronised", value=status.clock.synchronised
            )
        if status.clock.estimated_error_s is not None:
            yield GaugeMetricFamily(
                "ltm_clock_error_seconds",
                "Clock error as the kernel estimates it",
                value=status.clock.estimated_error_s,
            )
        disks = [disk for disk in status.disks if disk.total >= 0]
        free = [((disk.folder,), disk.free) for disk in disks]
        yield _gauge("ltm_disk_free_bytes", "Free space of a storage folder", free, ("folder",))
        total = [((disk.folder,), disk.total) for disk in disks]
        yield _gauge("ltm_disk_bytes", "Size of that file system", total, ("folder",))
        yield GaugeMetricFamily("ltm_memory_bytes", "Total memory of the machine", value=status.memory_total)
        yield GaugeMetricFamily(
            "ltm_memory_available_bytes", "Available memory of the machine", value=status.memory_available
        )


def _gauge(
    name: str, text: str, samples: Sequence[tuple[tuple[str, ...], float]], labels: Sequence[str]
) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, text, labels=labels)
    for values, value in samples:
        family.add_metric(values, value)
    return family


def exposition(status: TowerStatus) -> bytes:
    """Return the answer to a scrape."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(TowerCollector(status))
    return bytes(generate_latest(registry))


def _has_own(key: str) -> bool:
    return key in OWN or key.startswith(("dropped.", "noted.", "reason.", "latency_", "work_"))
