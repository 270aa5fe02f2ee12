"""Life of the process behind `ltm region`: it answers monitoring systems, says what is wrong, and ends in order."""

from __future__ import annotations

import signal
import sys
import threading
import time
from typing import Final

from ltm_core.disk_io import make_folder
from ltm_core.uplink.config import RegionConfig
from ltm_ros.health import machine
from ltm_ros.health.metrics import METRICS_KIND, exposition
from ltm_ros.health.patient_server import PatientServer
from ltm_ros.health.tower_status import TowerStatus, TowerWatch
from ltm_ros.health.web_server import Answer
from ltm_ros.launching.runner import print_line
from ltm_ros.region.service import RegionService
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.kernel_clock import kernel_clock

SAID_EVERY_S: Final = 60.0
SWITCH_S: Final = 0.0005
"""After which the thread that counts lets that of the connection in. A message comes by several reads, before
each of which that may have to wait as long: with Python's 5 ms, tens of milliseconds a message."""


def run_region(config: RegionConfig) -> None:
    """Until SIGINT or SIGTERM. Raises LtmError for what cannot be taken."""
    for folder in (config.folder, *([config.export.folder] if config.export else [])):
        make_folder(folder)
    sys.setswitchinterval(SWITCH_S)
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    health = Health()
    service = RegionService(config, health)
    watch = RegionWatch(config, service, health)
    print_line(
        f"-- {config.name}: {len(config.towers)} towers, "
        f"{service.aggregator.persistence.saved_frames} frames in {config.folder}"
    )
    threading.Thread(target=watch.run, args=(stopping,), name="watch", daemon=True).start()
    service.run(stopping)
    watch.close()
    lost = service.aggregator.persistence.unsaved_frames
    print_line(f"-- {config.name} has ended; {lost} frames were not stored, which their towers send again")


class RegionWatch:
    """Says what is wrong once a minute, and answers HTTP where the region's site file has a section `health`."""

    def __init__(self, config: RegionConfig, service: RegionService, health: Health) -> None:
        site = service.aggregator.site
        self._config, self._health = config, health
        self._name = f"/{site.name}/region"
        self._watch = TowerWatch(site.name, [self._name], site.health.frame_age if site.health else 0.0)
        self._lock = threading.Lock()
        self._server: PatientServer | None = None
        if site.health is not None:
            self._server = PatientServer(
                site.health,
                {
                    "/metrics": lambda: Answer(exposition(self.status()), METRICS_KIND),
                    "/status.json": lambda: Answer.json(self.status().as_dict()),
                },
                {},
                health,
                _say,
                _say,
            )

    def status(self) -> TowerStatus:
        """Now."""
        summary, now_s = self._health.summary(), time.monotonic()
        message = summary["last_error"] if self._health.troubled else "ok"
        with self._lock:
            self._watch.hear(self._name, self._health.troubled, message, summary, now_s)
            return self._watch.status(
                now_s,
                time.time(),
                versions=machine.versions(),
                clock=kernel_clock(),
                disks=machine.disks([str(self._config.folder)]),
                memory=machine.memory(),
                process_memory={},
            )

    def run(self, stopping: threading.Event) -> None:
        said = ""
        while not stopping.wait(SAID_EVERY_S):
            summary = self._health.summary()
            drops = {
                key.removeprefix("dropped."): value for key, value in summary.items() if key.startswith("dropped.")
            }
            line = (
                f"-- {summary.get('frames', '0')} frames; given up: {drops or 'nothing'}; last: {summary['last_error']}"
            )
            if line != said:
                said = line
                print_line(line)

    def close(self) -> None:
        if self._server is not None:
            self._server.close()


def _say(line: str) -> None:
    print_line(f"-- {line}")
