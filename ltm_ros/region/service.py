"""Run `ltm region`: link, map, exports, and health."""

import secrets
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Final

from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2

from ltm_core.pipeline.kernels import compile_kernels
from ltm_core.storage.disk_io import make_folder
from ltm_core.uplink.config import AGGREGATOR, RegionConfig
from ltm_ros.launching.runner import print_line
from ltm_ros.region.aggregator import Aggregator, RegionExports
from ltm_ros.region.mqtt_link import Inbox, MqttLink, ack_topic, presence_topic, votes_topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.web_server import Route, WebResponse
from ltm_ros.tower.health_client import PatientServer
from ltm_ros.tower.machine import Machine
from ltm_ros.tower.metrics import METRICS_KIND, exposition
from ltm_ros.tower.tower_status import TowerStatus, TowerWatch

SETTLE_S: Final = 0.25
"""Seconds for which frames are counted before they are stored together and acknowledged."""
SHOWN_SHARE: Final = 0.1
"""Share of the time for recomputing the map; with many frames it is done in batches."""


class RegionService:
    """Counts, stores and sends until stopped. Raises LtmError for an invalid site, store or certificate."""

    def __init__(self, config: RegionConfig, health: Health, now_ns: Callable[[], int] = time.time_ns) -> None:
        self._config, self._health = config, health
        self.aggregator = Aggregator(config, health, now_ns)
        # Loaded before the first frame, so that towers do not wait for it after an outage.
        compile_kernels("fuel_map", self.aggregator.site)
        serialize_message(PointCloud2())
        self._inbox = Inbox(config.towers, health)
        self._life = secrets.token_hex(8).encode()
        self._presence = presence_topic(config.name)
        self._link = MqttLink(
            config.broker,
            self.aggregator.identity,
            f"{config.name}-{AGGREGATOR}",
            [votes_topic(config.name, "+")],
            lambda topic, payload: self._inbox.put(topic.rpartition("/")[2], payload),
            health,
            will=(self._presence, b""),
        )
        self._exports = None if config.export is None else RegionExports(config.export, self.aggregator, health)
        self._connections = 0
        self._last = time.monotonic()
        self._shown_at, self._showing_s = 0.0, 0.0

    def run(self, stopping: threading.Event) -> None:
        """Count, store, acknowledge and send until stopped; then store the rest."""
        self._link.start()
        try:
            while not stopping.is_set():
                self.step(SETTLE_S)
        finally:
            self._link.send(self._presence, b"", retain=True)
            changed = bool(self.aggregator.persistence.show())
            self._answer(self.aggregator.close())
            if self._exports is not None:
                self._exports.close(changed)
            self._link.stop()

    def step(self, patience_s: float) -> None:
        """Run one turn: count frames, for `SETTLE_S` at most, until none has come for `patience_s`; then store and
        acknowledge them."""
        until = time.monotonic() + SETTLE_S
        while (wait_s := until - time.monotonic()) > 0 and (came := self._inbox.get(min(wait_s, patience_s))):
            self.aggregator.take(*came)
        self._health.gauge("waiting_bytes", self._inbox.size)
        now = time.monotonic()
        self.aggregator.persistence.wait(now - self._last)
        self._last = now
        changed = False
        if now >= self._shown_at + self._showing_s * (1 / SHOWN_SHARE - 1):
            changed = bool(self.aggregator.persistence.show())
            self._shown_at = time.monotonic()
            self._showing_s = self._shown_at - now
        answers = self.aggregator.settle()
        # The presence is sent on each new connection, because the broker may have lost it.
        connections = self._link.connections
        if self._connections != connections and self._link.send(self._presence, self._life, retain=True):
            self._connections = connections
        self._answer(answers)
        if self._exports is not None:
            self._exports.look(now, changed)

    def _answer(self, answers: dict[str, list[bytes]]) -> None:
        for tower, sealed in answers.items():
            for content in sealed:
                # A lost acknowledgement is requested again when the frame is repeated.
                self._link.send(ack_topic(self._config.name, tower), content)


SAID_EVERY_S: Final = 60.0
SWITCH_S: Final = 0.0005
"""Seconds after which the counting thread yields to the connection's. A message takes several reads, each of which may
wait as long: with Python's 5 ms, tens of milliseconds per message."""


def run_region(config: RegionConfig) -> None:
    """Run until SIGINT or SIGTERM. Raises LtmError for an invalid configuration."""
    for folder in (config.folder, *([config.export.folder] if config.export else [])):
        make_folder(folder)
    sys.setswitchinterval(SWITCH_S)
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    health = Health()
    service = RegionService(config, health)
    watch = RegionWatch(config, service, health)
    frames = service.aggregator.persistence.saved_frames
    _say(f"{config.name}: {len(config.towers)} towers, {frames} frames in {config.folder}")
    threading.Thread(target=watch.run, args=(stopping,), name="watch", daemon=True).start()
    service.run(stopping)
    watch.close()
    lost = service.aggregator.persistence.unsaved_frames
    _say(f"{config.name} has ended; {lost} frames were not stored, which their towers send again")


class RegionWatch:
    """Reports problems once a minute, and serves HTTP if the region's site file has a section `health`."""

    def __init__(self, config: RegionConfig, service: RegionService, health: Health) -> None:
        self._folder, self._health = str(config.folder), health
        self._site = service.aggregator.site
        self._server: PatientServer | None = None
        if (served := self._site.health) is not None:
            routes: dict[str, Route] = {
                "GET /metrics": lambda _: WebResponse(exposition(self.status()), METRICS_KIND),
                "GET /status.json": lambda _: WebResponse.json(self.status().as_dict()),
            }
            self._server = PatientServer(served, routes, health, _say, _say)

    def status(self) -> TowerStatus:
        """Return the current status."""
        health, now_s, name = self._health, time.monotonic(), f"/{self._site.name}/region"
        watch = TowerWatch(self._site.name, [name], self._site.health.frame_age if self._site.health else 0.0)
        watch.hear(name, health.troubled, health.message, health.summary(), now_s)
        return watch.status(now_s, time.time(), Machine.read([self._folder]))

    def run(self, stopping: threading.Event) -> None:
        said = ""
        while not stopping.wait(SAID_EVERY_S):
            summary = self._health.summary()
            drops = {key.removeprefix("dropped."): n for key, n in summary.items() if key.startswith("dropped.")}
            line = f"{summary.get('frames', '0')} frames; dropped: {drops or 'nothing'}; last: {summary['last_error']}"
            if line != said:
                said = line
                _say(line)

    def close(self) -> None:
        if self._server is not None:
            self._server.close()


def _say(line: str) -> None:
    print_line(f"-- {line}")
