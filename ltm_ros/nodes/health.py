"""health: answer monitoring systems and serve the status page, from the other nodes' /diagnostics."""

import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from http import HTTPStatus
from importlib.resources import files
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from pydantic import Field
from rclpy.node import Node

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.site.site_io import load_site
from ltm_msgs_py.status import status_message
from ltm_ros.runtime.delivery_checks import DiagnosticsPublisher
from ltm_ros.runtime.handler import NodeConfig
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.node_process import run_until_stopped
from ltm_ros.runtime.outlet_node import read_parameters
from ltm_ros.runtime.web_server import Route, WebResponse
from ltm_ros.tower.alerts import AlertSender
from ltm_ros.tower.health_client import PatientServer
from ltm_ros.tower.last_pictures import LastPictures
from ltm_ros.tower.live_stream import KINDS, LiveStream
from ltm_ros.tower.machine import Machine
from ltm_ros.tower.marks import Marks
from ltm_ros.tower.metrics import METRICS_KIND, exposition
from ltm_ros.tower.tower_status import CameraStatus, TowerStatus, TowerWatch, camera_of


class HealthNodeConfig(NodeConfig):
    expected: list[str] = Field(default_factory=list)
    """Full names of the nodes that must report."""
    folders: list[str] = Field(default_factory=list)
    """Storage folders whose disks are checked."""


class HealthNode(Node):  # type: ignore[misc]
    def __init__(self) -> None:
        super().__init__("health", automatically_declare_parameters_from_overrides=True)
        config = read_parameters(self, HealthNodeConfig)
        site = load_site(config.site)
        if site.health is None:
            raise ConfigError(f"{config.site}: has no section `health`")
        self._watch = TowerWatch(site.name, config.expected, site.health.frame_age)
        self._site, self._lock = site.name, threading.Lock()
        self._folders = config.folders
        self._health = Health()
        cameras = list(dict.fromkeys(filter(None, map(camera_of, config.expected))))
        steady = DiagnosticsPublisher.steady_clock()
        self._pictures = LastPictures(self, site, cameras, self._health)
        self.create_timer(1.0, self._pictures.tick, clock=steady)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 100)
        own = {self.get_fully_qualified_name(): self._health}
        self._diagnostics = DiagnosticsPublisher(self, own, others=self._camera_states)
        page = (files("ltm_ros.tower") / "status_page.html").read_bytes()
        live = LiveStream(self._page, self._pictures, lambda error: self._health.drop(cause_of(error), str(error)))
        routes: dict[str, Route] = {
            "GET /": lambda _: WebResponse(page, "text/html; charset=utf-8"),
            "GET /metrics": lambda _: WebResponse(exposition(self.status()), METRICS_KIND),
            "GET /healthz": lambda _: _verdict(self.status(), "alive"),
            "GET /readyz": lambda _: _verdict(self.status(), "ready"),
            "GET /status.json": lambda _: WebResponse.json(self.status().as_dict()),
            "GET /page.json": lambda _: WebResponse.json(self._page()),
            "GET /map.png": partial(_picture, self._map_png, "image/png"),
            "GET /live": lambda _: WebResponse(b"", "application/octet-stream", stream=live.stream()),
        }
        for camera in cameras:
            for kind in (*KINDS, "full"):
                draw = partial(self._pictures.jpeg, camera, kind)
                routes[f"GET /picture/{camera}/{kind}.jpg"] = partial(_picture, draw, "image/jpeg")
        self._marks = None
        if site.locating is not None:
            self._marks = Marks(self, site.name, cameras, self._pictures.shown, self._health)
            routes["POST /mark"] = self._marks.take
        self._alerts = None
        if site.alerts is not None and not self.get_parameter("use_sim_time").value:  # no alerts of a replay
            self._alerts = AlertSender(site.alerts, site.name, site.watchdog.slow, self._health)
            self.create_timer(5.0, self._send_alerts, clock=steady)
        log = self.get_logger()
        self._server = PatientServer(site.health, routes, self._health, log.info, log.warning)

    def close(self) -> int:
        self._server.close()
        if self._alerts is not None:
            self._alerts.close()
        return 0

    def _send_alerts(self) -> None:
        status = self.status()
        if self._alerts is not None:
            self._alerts.look(status.conditions, time.monotonic(), status.time_s)

    def _page(self) -> dict[str, Any]:
        """Return the data that an open status page requests repeatedly."""
        self._pictures.look()
        said = self.status().as_dict() | {"pictures": self._pictures.stamps_s(), "places": None}
        said["legends"] = self._pictures.legends
        if self._marks is not None:
            said |= {"places": self._marks.places(), "wrong": [*said["wrong"], *self._marks.wrong()]}
        return said

    def _map_png(self) -> bytes | None:
        return self._pictures.map_png([] if self._marks is None else self._marks.on_map())

    def status(self) -> TowerStatus:
        """Return the current status; thread-safe."""
        now = time.monotonic(), self.get_clock().now().nanoseconds / 1e9
        machine = Machine.read(self._folders)
        with self._lock:
            return self._watch.status(*now, machine)

    def _camera_states(self) -> list[DiagnosticStatus]:
        """Return the status of each camera, named `/SITE/CAMERA`."""
        with self._lock:
            cameras = self._watch.cameras(time.monotonic(), self.get_clock().now().nanoseconds / 1e9)
        return [camera_diagnostic(self._site, camera) for camera in cameras]

    def _hear(self, message: DiagnosticArray) -> None:
        now_s = time.monotonic()
        with self._lock:
            for status in message.status:
                values = {value.key: value.value for value in status.values}
                self._watch.hear(status.name, status.level != DiagnosticStatus.OK, status.message, values, now_s)


def camera_diagnostic(site: str, camera: CameraStatus) -> DiagnosticStatus:
    level = DiagnosticStatus.ERROR if camera.state.failing else DiagnosticStatus.WARN if camera.wrong else b"\0"
    since = datetime.fromtimestamp(camera.since_s, UTC)
    values = {"state": camera.state.value, "state_since": f"{camera.since_s:.0f}", "state_why": camera.why}
    message = f"{camera.state} since {since:%H:%M:%S} UTC{f': {camera.why}' if camera.why else ''}"
    return status_message(f"/{site}/{camera.name}", level, message, values)


def _verdict(status: TowerStatus, what: str) -> WebResponse:
    fine = status.alive if what == "alive" else status.ready
    lines = [what if fine else f"not {what}", *status.wrong, ""]
    code = HTTPStatus.OK if fine else HTTPStatus.SERVICE_UNAVAILABLE
    return WebResponse("\n".join(lines).encode(), status=code)


def _picture(draw: Callable[[], bytes | None], kind: str, _: bytes) -> WebResponse:
    try:
        drawn = draw()
    except LtmError as error:
        return WebResponse.error(HTTPStatus.INTERNAL_SERVER_ERROR, str(error))
    return WebResponse.error(HTTPStatus.NOT_FOUND, "not available yet") if drawn is None else WebResponse(drawn, kind)


CONFIG = HealthNodeConfig

if __name__ == "__main__":
    run_until_stopped("health", HealthNode)
