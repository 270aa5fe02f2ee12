"""Export a tower's state as metrics in Prometheus's text format."""

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
TIMES = {"latency": "Time from a frame's stamp to a result", "work": "Processing time of one message"}
OWN = {"dropped", "newest_stamp", *OUTBOX_KEYS}
"""Keys of `/diagnostics` that other metrics show; other numbers are exported as `ltm_node_value`."""


class TowerCollector(Collector):
    """Metrics of one state; create a new one for each scrape."""

    def __init__(self, status: TowerStatus) -> None:
        self._status = status

    def collect(self) -> Iterable[Metric]:
        status, machine = self._status, self._status.machine
        names = tuple(name.replace("-", "_") for name in machine.versions)
        build = (status.site, *machine.versions.values()), 1
        yield _gauges("ltm_build_info", "Versions of the running software", [build], ("site", *names))
        yield _gauge("ltm_alive", "Whether every node reports (/healthz)", status.alive)
        yield _gauge("ltm_ready", "Whether every node reports and every camera sends (/readyz)", status.ready)
        yield _gauge("ltm_wrong", "Number of current problems", len(status.wrong))
        problems = [((one.kind, one.name), bool(one.problem)) for one in status.conditions]
        yield _gauges("ltm_problem", "Whether something has a problem", problems, ("kind", "name"))
        yield from self._cameras()
        yield from self._nodes()
        if (outbox := status.outbox) is not None:
            yield _gauge("ltm_outbox_frames", "Frames queued for the region's map", outbox.frames)
            yield _gauge("ltm_outbox_bytes", "Size of their votes", outbox.bytes)
            yield _gauge("ltm_outbox_age_seconds", "Age of the oldest queued frame", outbox.age_s)
            yield _gauge("ltm_link_up", "Whether the region's map is connected", outbox.link_up)
        clock = machine.clock
        if clock.synchronised is not None:
            yield _gauge("ltm_clock_synchronised", "Whether the system clock is synchronised", clock.synchronised)
        if clock.estimated_error_s is not None:
            yield _gauge("ltm_clock_error_seconds", "Clock error as the kernel estimates it", clock.estimated_error_s)
        disks = [disk for disk in machine.disks if disk.total >= 0]
        free = [((disk.folder,), disk.free) for disk in disks]
        yield _gauges("ltm_disk_free_bytes", "Free space of a storage folder", free, ("folder",))
        total = [((disk.folder,), disk.total) for disk in disks]
        yield _gauges("ltm_disk_bytes", "Size of that file system", total, ("folder",))
        yield _gauge("ltm_memory_bytes", "Total memory of the machine", machine.memory_total)
        yield _gauge("ltm_memory_available_bytes", "Available memory of the machine", machine.memory_available)

    def _cameras(self) -> Iterator[Metric]:
        cameras = self._status.cameras
        states = [((one.name, state), one.state is state) for one in cameras for state in CameraState]
        yield _gauges("ltm_camera_state", "Whether a camera is in a state", states, ("camera", "state"))
        since = "ltm_camera_state_since_timestamp_seconds"
        yield _gauges(since, "Start of a camera's state", [((one.name,), one.since_s) for one in cameras], ("camera",))
        ages = [((one.name,), one.frame_age_s) for one in cameras if one.frame_age_s is not None]
        yield _gauges("ltm_frame_age_seconds", "Age of the newest frame", ages, ("camera",))
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
        yield _gauges(
            "ltm_fusion_verdict", "Whether this is the last verdict on depth", verdicts, ("camera", "verdict")
        )

    def _nodes(self) -> Iterator[Metric]:
        up = GaugeMetricFamily("ltm_node_up", "Whether a node reports", labels=NODE)
        warning = GaugeMetricFamily("ltm_node_warning", "Whether it dropped something in the last 10 s", labels=NODE)
        numbers: dict[str, Metric] = {
            key: CounterMetricFamily(f"ltm_{key}", text, labels=NODE) for key, text in COUNTERS.items()
        }
        numbers["rate_hz"] = GaugeMetricFamily("ltm_rate_hertz", "Messages published per second", labels=NODE)
        used = "Processor time of a node that shares a process"
        numbers["cpu_s"] = CounterMetricFamily("ltm_cpu_seconds", used, labels=NODE)
        kinds = {
            kind: CounterMetricFamily(f"ltm_{kind}", text, labels=(*NODE, label))
            for kind, (label, text) in BY_KIND.items()
        }
        times = {
            name: GaugeMetricFamily(f"ltm_{name}_seconds", text, labels=(*NODE, "quantile"))
            for name, text in TIMES.items()
        }
        values = GaugeMetricFamily("ltm_node_value", "Other numbers that a node reports", labels=(*NODE, "name"))
        for node in self._status.nodes:
            labels = (node.name, node.camera)
            up.add_metric(labels, node.state in ("ok", "warning"))
            warning.add_metric(labels, node.state == "warning")
            for kind, family in kinds.items():
                for name, count in node.counts(f"{kind}.").items():
                    family.add_metric((*labels, name), count)
            for name, gauge in times.items():
                for quantile, suffix in QUANTILES.items():
                    if (number := node.number(f"{name}_{suffix}_ms")) is not None:
                        gauge.add_metric((*labels, quantile), number / 1000)
            for key in node.values:
                if (number := node.number(key)) is None:
                    continue
                if key in numbers:
                    numbers[key].add_metric(labels, number)  # type: ignore[attr-defined]
                elif key not in OWN and not key.startswith(("dropped.", "noted.", "reason.", "latency_", "work_")):
                    values.add_metric((*labels, key), number)
        yield from (up, warning, *numbers.values(), *kinds.values(), *times.values(), values)


def _gauge(name: str, text: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, text, value=value)


def _gauges(
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
