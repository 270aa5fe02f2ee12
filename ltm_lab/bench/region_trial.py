"""The processes of a region on trial: towers, a broker and the map, started and killed at will."""

from __future__ import annotations

import json
import shutil
import subprocess  # nosec B404 # argument lists, no shell
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import yaml
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from ltm_core.base.errors import LtmError
from ltm_core.base.resources import config_path
from ltm_core.fuel.surface_change import LivingFuelMap
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, open_stored_map
from ltm_core.site.site_io import load_site
from ltm_core.uplink.config import AGGREGATOR, BrokerConfig, UplinkConfig
from ltm_core.uplink.envelope import VotesGrid
from ltm_core.vision.labels import LabelSet
from ltm_lab.bench.network_site import Traffic
from ltm_lab.bench.ports import free_ports
from ltm_lab.bench.region_tower import CAMERA, TowerOrder
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_ros.launching.watchdog import process_use
from ltm_ros.region.certs import BROKER, TrialAuthority
from ltm_ros.runtime.ros_environment import ros_environment

REGION: Final = "trial"
PERIOD_NS: Final = 10**9
PATIENCE_S: Final = 1800.0


class RegionTrial:
    """The processes of one run, in a folder of their own; a context manager. Raises LtmError where no mosquitto is."""

    def __init__(self, folder: Path, traffic: Traffic, seconds: int) -> None:
        """`traffic`: of `write_region`, whose towers have one camera each and send a frame a second."""
        self.mosquitto = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
        if self.mosquitto is None:
            raise LtmError("no mosquitto is installed: apt install mosquitto")
        self._folder, self._traffic, self._seconds = folder, traffic, seconds
        self.towers = list(traffic.messages)
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self.said: dict[str, dict[str, Any]] = {name: {"kept": 0, "waiting": -1, "dropped": {}} for name in self.towers}
        self.map_answers = False
        """Whether the region's map has started."""
        self._left = dict.fromkeys(self.towers, seconds)
        """Frames of each tower that no answer has been heard of."""
        self._lock = threading.RLock()
        self.begin_ns = time.time_ns() - (seconds + 60) * PERIOD_NS
        self._write()

    def __enter__(self) -> RegionTrial:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for name in list(self._processes):
            self.kill(name)

    @property
    def region_file(self) -> Path:
        return self._folder / "region.yaml"

    @property
    def store(self) -> Path:
        return self._folder / "map" / STORE_FILE

    @property
    def frames(self) -> int:
        return len(self.towers) * self._seconds

    def start(self, name: str) -> None:
        """The broker, the region's map, or a tower, which goes on after what it has said is kept."""
        if name == BROKER:
            command = [str(self.mosquitto), "-c", str(self._folder / "certs/mosquitto.conf")]
        elif name == AGGREGATOR:
            command = [sys.executable, "-m", "ltm_ros.cli.main", "region", str(self.region_file)]
        else:
            order = self._folder / f"{name}.json"
            command = [sys.executable, "-m", "ltm_lab.bench.region_tower", str(order), str(self.said[name]["kept"])]
        with (self._folder / f"{name}.log").open("a", encoding="utf-8") as log:
            process = subprocess.Popen(  # nosec B603 # our own program, and a fixed one of the system
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=ros_environment(busy=False),
            )
        with self._lock:
            self._processes[name] = process
            if name in self.said:
                self.said[name] |= {"waiting": -1}
            elif name == AGGREGATOR:
                self.map_answers = False
        threading.Thread(target=self._read, args=(name, process), daemon=True).start()

    def kill(self, name: str) -> None:
        """With SIGKILL."""
        process = self._processes.pop(name)
        process.kill()
        process.wait()

    def cpu_s(self, name: str) -> float:
        """Processor time that a process has used so far."""
        return process_use(self._processes[name].pid).cpu_s

    def wait(self, what: str, reached: Callable[[], bool]) -> None:
        """Raises LtmError after `PATIENCE_S`, or where a process has ended by itself."""
        until = time.monotonic() + PATIENCE_S
        while not reached():
            with self._lock:
                ended = [name for name, process in self._processes.items() if process.poll() is not None]
            if ended or time.monotonic() > until:
                raise LtmError(
                    f"{what}: {'ended: ' + ', '.join(ended) if ended else 'not reached'}: {self._last_words(ended)}"
                )
            time.sleep(0.05)

    def all_kept(self) -> bool:
        return all(said["kept"] >= self._seconds for said in self.said.values())

    def all_sent(self) -> bool:
        return self.all_kept() and all(said["waiting"] == 0 for said in self.said.values())

    def answered(self) -> float:
        """Share of all frames that left the outboxes, as far as towers have said."""
        return 1.0 - sum(self._left.values()) / self.frames

    def expected(self) -> LivingFuelMap:
        """The map of all frames, counted in this process without any link."""
        site, evidence = self._empty()
        for name in self.towers:
            order = TowerOrder.model_validate_json((self._folder / f"{name}.json").read_text(encoding="utf-8"))
            pool = [path.read_bytes() for path in order.messages]
            names = LabelSet.load(config_path(site.labels)).names
            for number in range(order.frames):
                message = deserialize_message(order.frame(number, pool).message, PointCloud2)
                evidence.add(msg_to_votes(message, evidence.geometry, names, f"{name}_{CAMERA}"))
        return evidence

    def found(self) -> tuple[LivingFuelMap, dict[str, int]]:
        """The map in the store, and the frames counted of each source."""
        site, evidence = self._empty()
        with open_stored_map(self.store, site, evidence) as opened:
            return evidence, opened.sources()

    def _empty(self) -> tuple[Any, LivingFuelMap]:
        site = load_site(self._folder / "site.yaml")
        labels = LabelSet.load(config_path(site.labels))
        return site, site_evidence_map(site, site.fuel_geometry(site.open_dem()), labels)

    def _read(self, name: str, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None  # nosec B101 # tells the type checker what holds
        for line in process.stdout:
            if name == AGGREGATOR and self._processes.get(name) is process:
                self.map_answers = True
            if name in self.said and line.startswith("{") and line.endswith("\n"):
                with self._lock:
                    if self._processes.get(name) is process:
                        said = self.said[name] = json.loads(line)
                        if said["kept"] >= self._seconds and said["waiting"] >= 0:
                            self._left[name] = said["waiting"]

    def _last_words(self, names: list[str]) -> str:
        logs = [(self._folder / f"{name}.log").read_text(encoding="utf-8")[-1500:] for name in names]
        return " | ".join(logs) or json.dumps(self.said)

    def _write(self) -> None:
        site = yaml.safe_load(self._traffic.site.read_text(encoding="utf-8"))
        site |= {"cameras": {f"{name}_{CAMERA}": {} for name in self.towers}}
        site["dem"] = {"path": str(self._traffic.site.parent / "dem.tif")}
        (self._folder / "site.yaml").write_text(yaml.safe_dump(site), encoding="utf-8")
        port = free_ports(1)[0]
        certs = self._folder / "certs"
        TrialAuthority(certs, days=2).make(REGION, self.towers, ["127.0.0.1"], "127.0.0.1", port)

        def broker(name: str) -> dict[str, Any]:
            files = {"ca": certs / "ca.crt", "certificate": certs / f"{name}.crt", "key": certs / f"{name}.key"}
            return {"host": "127.0.0.1", "port": port, **{what: str(path) for what, path in files.items()}}

        region = {
            "name": REGION,
            "site": "site.yaml",
            "folder": "map",
            "towers": self.towers,
            "broker": broker(AGGREGATOR),
        }
        self.region_file.write_text(yaml.safe_dump(region), encoding="utf-8")
        loaded = load_site(self._folder / "site.yaml")
        grid = VotesGrid.of(loaded.in_crs(loaded.fuel_geometry(loaded.open_dem())), loaded.origin)
        for name, pool in self._traffic.messages.items():
            folder = self._folder / name
            folder.mkdir()
            files = [folder / f"{number:03d}.cdr" for number in range(len(pool))]
            for path, content in zip(files, pool, strict=True):
                path.write_bytes(content)
            order = TowerOrder(
                config=UplinkConfig(name=REGION, tower=name, broker=BrokerConfig(**broker(name))),
                grid=grid,
                messages=files,
                frames=self._seconds,
                begin_ns=self.begin_ns,
                period_ns=PERIOD_NS,
                folder=folder,
            )
            (self._folder / f"{name}.json").write_text(order.model_dump_json(), encoding="utf-8")
