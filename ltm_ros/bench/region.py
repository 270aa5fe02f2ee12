"""`ltm bench region`: towers whose link was down, a broker and a region's map, killed at random.

Whether the map then is, to the bit, the one of all frames, and how fast it caught up.
"""

from __future__ import annotations

import json
import random
import shutil
import socket
import subprocess  # nosec B404 # argument lists, no shell
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
import yaml
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from ltm_core.errors import LtmError
from ltm_core.fuel.site_map import site_evidence_map
from ltm_core.fuel.stored_map import STORE_FILE, open_stored_map
from ltm_core.fuel.surface_change import LivingFuelMap
from ltm_core.resources import config_path
from ltm_core.site_io import load_site
from ltm_core.uplink.config import AGGREGATOR, BrokerConfig, UplinkConfig
from ltm_core.uplink.envelope import VotesGrid
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.votes import msg_to_votes
from ltm_ros.bench.network_site import Traffic, write_region
from ltm_ros.bench.region_tower import CAMERA, TowerOrder
from ltm_ros.launching.ros_environment import ros_environment
from ltm_ros.launching.watchdog import process_use
from ltm_ros.region.certs import BROKER, TrialAuthority

REGION: Final = "trial"
PERIOD_NS: Final = 10**9
PATIENCE_S: Final = 1800.0
DOWN_S: Final = (0.1, 1.5)
"""For which a killed process stays away."""


@dataclass(frozen=True)
class RegionResult:
    """One run. `frames`: sent by all towers; `stored`: counted in the map, each once; `equal`: the map is, to the bit,
    that of all frames. `catch_up_s`: from the link's return until every outbox was empty.
    """

    frames: int
    stored: int
    equal: bool
    kills: dict[str, int]
    catch_up_s: float
    times_real: float
    """Seconds of votes a second, by the clock."""
    cpu_ms_a_frame: dict[str, float]
    """Processor time while it caught up: of all `towers` together, of the `broker`, of the `map`; empty: some were
    killed meanwhile."""
    times_real_on_cores: float | None
    """Seconds of votes a second of processor time of the process that used most: as where each has a core of its own,
    and none waits for another."""
    dropped: dict[str, int]
    bytes_a_frame: float


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
            command = [sys.executable, "-m", "ltm_ros.bench.region_tower", str(order), str(self.said[name]["kept"])]
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
        port = _free_port()
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


@dataclass
class Killer:
    """Kills one of several processes, again and again, and starts it anew a moment later."""

    trial: RegionTrial
    names: list[str]
    random: random.Random
    kills: Counter[str] = field(default_factory=Counter)

    def kill_while_answered(self, kills: int) -> None:
        """Spread over the whole of the catching up: each after one more of as many parts of the frames."""
        for number in range(kills):
            self.trial.wait("more frames are answered for", partial(self._answered, number / (kills + 1)))
            self.kill(1.0)

    def _answered(self, share: float) -> bool:
        return self.trial.answered() >= share

    def kill(self, at_most_s: float) -> None:
        time.sleep(self.random.uniform(0, at_most_s))
        name = self.random.choice(self.names)
        self.trial.kill(name)
        self.kills[name if name in (BROKER, AGGREGATOR) else "towers"] += 1
        time.sleep(self.random.uniform(*DOWN_S))
        self.trial.start(name)


def run_region(
    folder: Path, traffic: Traffic, seconds: int, kills: int, seed: int, say: Callable[[str], None]
) -> RegionResult:
    """Fill the outboxes while the link is down, then let it return; a third of the kills fall into the first part.

    Raises LtmError where the run does not come to its end.
    """
    draws = random.Random(seed)  # nosec B311 # no secret
    with RegionTrial(folder, traffic, seconds) as trial:
        for name in [*trial.towers, AGGREGATOR]:
            trial.start(name)
        killer = Killer(trial, [*trial.towers, AGGREGATOR], draws)
        for _ in range(kills // 3):
            killer.kill(1.0)
        trial.wait("the outboxes have all frames", lambda: trial.all_kept() and trial.map_answers)
        say(f"link down: {trial.frames} frames in {len(trial.towers)} outboxes")
        begun, before = time.monotonic(), {name: trial.cpu_s(name) for name in [*trial.towers, AGGREGATOR]}
        trial.start(BROKER)
        killer.names = [BROKER, BROKER, AGGREGATOR, AGGREGATOR, *trial.towers]
        killer.kill_while_answered(kills - kills // 3)
        trial.wait("the outboxes are empty", trial.all_sent)
        took = time.monotonic() - begun
        say(f"caught up after {took:.1f} s with {sum(killer.kills.values())} kills")
        used = {name: trial.cpu_s(name) - before.get(name, 0.0) for name in [BROKER, *before]}
        parts = {"towers": sum(used[name] for name in trial.towers), "broker": used[BROKER], "map": used[AGGREGATOR]}
        trial.kill(AGGREGATOR)
        found, sources = trial.found()
        dropped = Counter[str]()
        for said in trial.said.values():
            dropped.update(said["dropped"])
        expected = {f"{name}_{CAMERA}": seconds for name in trial.towers}
        return RegionResult(
            frames=trial.frames,
            stored=sum(sources.values()),
            equal=sources == expected and same_map(found, trial.expected()),
            kills=dict(killer.kills),
            catch_up_s=took,
            times_real=seconds / took,
            cpu_ms_a_frame={} if kills else {part: 1000 * cpu_s / trial.frames for part, cpu_s in parts.items()},
            times_real_on_cores=None if kills else seconds / max(used.values()),
            dropped=dict(dropped),
            bytes_a_frame=traffic.bytes,
        )


def same_map(one: LivingFuelMap, other: LivingFuelMap) -> bool:
    """Whether every bit of the state of all cells is the same, and the time that the maps tell."""
    rows, cols = one.tiles
    for key in [(row, col) for row in range(rows) for col in range(cols)]:
        mine, theirs = one.tile_state(key), other.tile_state(key)
        if any(not np.array_equal(mine[name], theirs[name]) for name in mine):
            return False
    return one.newest_ns == other.newest_ns


def run_bench(
    towers: int,
    seconds: int,
    kills: int,
    seed: int,
    extent: float,
    views: int,
    say: Callable[[str], None],
    calm: bool = True,
) -> dict[str, RegionResult]:
    """`calm`: a run without kills, which tells how fast the map catches up; `killed`, unless there are none: with.

    Of both or one of them; of neither where there are no kills and `calm` is False.
    """
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as name:
        folder = Path(name)
        for part in ("traffic", "calm", "killed"):
            (folder / part).mkdir()
        traffic = write_region(folder / "traffic", towers, extent, views)
        results = {"calm": run_region(folder / "calm", traffic, seconds, 0, seed, say)} if calm else {}
        if kills:
            results["killed"] = run_region(folder / "killed", traffic, seconds, kills, seed, say)
        return results


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
