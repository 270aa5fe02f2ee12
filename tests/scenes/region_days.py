"""Days of a region in minutes: towers, a broker and the map in one process, on a clock that is turned by hand.

The broker is a table of who listens to what. All else is what runs on towers: outboxes in SQLite, signatures, the map's
store. A kill forgets what the object held in memory; its files stay as they are.
"""

from __future__ import annotations

import random
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from threading import Event
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from ltm_core.base.errors import StoreError
from ltm_core.fuel.surface_change import LivingFuelMap
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.uplink.config import AGGREGATOR, UplinkConfig
from ltm_core.uplink.outbox_io import OutboxFrame
from ltm_lab.bench.graph_site import stamped
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_ros.region.mqtt_link import Taker
from ltm_ros.region.service import RegionService
from ltm_ros.region.tower_link import TowerLink
from ltm_ros.runtime.health import Health
from scenes.region_scene import CAMERA, REGION, TOWERS, RegionScene, stamp_of

FAULTS = ("link", "link", "tower", "map", "broker", "lose", "twice", "alter", "outbox", "store")
"""What happens, as likely as it is named."""
LONGEST_FAULT_S = 1800


def same_map(one: LivingFuelMap, other: LivingFuelMap) -> bool:
    """Return whether all cells of two maps, and the time of their newest frames, are the same to the bit."""
    rows, cols = one.tiles
    for key in [(row, col) for row in range(rows) for col in range(cols)]:
        mine, theirs = one.tile_state(key), other.tile_state(key)
        if any(not np.array_equal(mine[name], theirs[name]) for name in mine):
            return False
    return one.newest_ns == other.newest_ns


class Broker:
    """Delivers at once, unless somebody's line is down or the fault of the minute says otherwise."""

    def __init__(self, draws: random.Random) -> None:
        self.links: list[BrokerLink] = []
        self.retained: dict[str, bytes] = {}
        self.fault = ""
        self._draws = draws
        self._kept: deque[tuple[str, bytes]] = deque(maxlen=50)
        """What was sent, to be sent again."""

    def publish(self, topic: str, payload: bytes, retain: bool) -> None:
        if retain:
            self.retained[topic] = payload
        copies = [(topic, payload)]
        if not retain and self.fault and self._draws.random() < 0.5:
            if self.fault == "lose":
                return
            if self.fault == "alter":
                place = self._draws.randrange(len(payload))
                copies = [(topic, payload[:place] + bytes([payload[place] ^ 4]) + payload[place + 1 :])]
            elif self.fault == "twice":
                copies = [*copies, *list(self._kept)[:3]]
        if not retain:
            self._kept.append((topic, payload))
        for name, content in copies:
            for link in list(self.links):
                link.hear(name, content)

    def end(self, name: str) -> None:
        """A client is killed."""
        next(link for link in self.links if link.name == name).stop()

    def restart(self) -> None:
        """It forgets all; connections are new."""
        self.retained.clear()
        for link in self.links:
            link.reconnect()


class BrokerLink:
    """`MqttLink` without a network."""

    broker: Broker

    def __init__(
        self,
        _config: Any,
        _identity: Any,
        client_id: str,
        topics: Sequence[str],
        take: Taker,
        health: Health,
        will: tuple[str, bytes] | None = None,
    ) -> None:
        self.name, self.topics, self._take, self._will = client_id, topics, take, will
        self.connected, self.connections = Event(), 0
        self.start()

    def start(self) -> None:
        if self not in self.broker.links:
            self.broker.links.append(self)
            self.reconnect()

    def reconnect(self) -> None:
        self.connected.set()
        self.connections += 1
        for topic, payload in list(self.broker.retained.items()):
            self.hear(topic, payload)

    def cut(self) -> None:
        """The line is down, and the broker has noticed."""
        if self.connected.is_set() and self._will is not None:
            self.broker.publish(*self._will, retain=True)
        self.connected.clear()

    def stop(self) -> None:
        self.cut()
        if self in self.broker.links:
            self.broker.links.remove(self)

    def hear(self, topic: str, payload: bytes) -> None:
        if self.connected.is_set() and any(_fits(topic, pattern) for pattern in self.topics):
            self._take(topic, payload)

    def send(self, topic: str, payload: bytes, retain: bool = False) -> bool:
        if self.connected.is_set():
            self.broker.publish(topic, payload, retain)
        return self.connected.is_set()


def _fits(topic: str, pattern: str) -> bool:
    return topic == pattern or (pattern.endswith("/+") and topic.rpartition("/")[0] == pattern[:-2])


def _away(*_: object) -> None:
    raise StoreError("the disk is away")


@dataclass
class RegionDays:
    """`period_s`: between two frames of a tower. `faults`: what happened, how often."""

    scene: RegionScene
    seed: int
    period_s: int = 120
    now_s: int = 0
    sent: dict[str, list[int]] = field(default_factory=lambda: {name: [] for name in TOWERS})
    """Seconds of each tower's frames."""
    faults: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    """Of all towers' lives."""

    def __post_init__(self) -> None:
        self._draws = random.Random(self.seed)
        self._broker = Broker(self._draws)
        self._make_link: Any = type("Link", (BrokerLink,), {"broker": self._broker})
        self._mended: dict[str, int] = {}
        """When a line, or a disk, serves again."""
        self._messages = [self.scene.votes(number) for number in range(6)]
        self._map = self._made_map()
        self._towers = {name: self._tower(name) for name in TOWERS}

    @property
    def stamp_ns(self) -> int:
        return stamp_of(self.now_s)

    def run(self, minutes: int, faults: bool = True) -> None:
        """Frames all the while; a fault in each minute."""
        for _ in range(minutes):
            if faults:
                self._fault()
            for _ in range(2):
                self._half_minute(frames=True)
            self._broker.fault = ""

    def drain(self, minutes: int) -> None:
        """No new frames and no faults; until all is answered for, or so long."""
        self._mended = dict.fromkeys(self._mended, self.now_s)
        for _ in range(2 * minutes):
            self._half_minute(frames=False)
            if not self.waiting:
                return

    @property
    def waiting(self) -> int:
        """Frames in outboxes and on their way there."""
        return sum(link.waiting for link, _ in self._towers.values())

    @property
    def evidence(self) -> LivingFuelMap:
        return self._map.aggregator.persistence.map

    def expected(self) -> LivingFuelMap:
        """The map of all frames, counted without any link."""
        aggregator, scene = self._map.aggregator, self.scene
        evidence = site_evidence_map(scene.site, scene.geometry, aggregator.labels)
        for name, seconds in self.sent.items():
            for second in seconds:
                message = deserialize_message(self.frame(second).message, PointCloud2)
                evidence.add(msg_to_votes(message, scene.geometry, aggregator.labels.names, f"{name}_{CAMERA}"))
        return evidence

    def stored(self) -> dict[str, int]:
        """Frames in the map's store, by source."""
        store = self._map.aggregator.persistence.store
        assert store is not None
        return store.sources()

    def close(self) -> None:
        for link, health in self._towers.values():
            self._let_go(link, health)
        self._map.aggregator.close()
        self.dropped += Counter(self._map_health.dropped)

    def _tower(self, name: str) -> tuple[TowerLink, Health]:
        config, health = UplinkConfig(name=REGION, tower=name, broker=self.scene.broker(name)), Health()
        file = self.scene.folder / f"{name}.sqlite"
        return TowerLink(config, self.scene.grid, file, health, lambda: None, self._make_link), health

    def _made_map(self) -> RegionService:
        self._map_health = Health()
        return RegionService(self.scene.config, self._map_health, lambda: self.stamp_ns, self._make_link)

    def _let_go(self, link: TowerLink, health: Health) -> None:
        link.close()
        self.dropped += Counter(health.dropped)

    def _half_minute(self, frames: bool) -> None:
        self.now_s += 30
        for what in [name for name, until in self._mended.items() if until <= self.now_s]:
            del self._mended[what]
        for link in self._broker.links:
            if f"line {link.name}" in self._mended:
                link.cut()
            elif not link.connected.is_set():
                link.reconnect()
        for index, (name, (link, health)) in enumerate(self._towers.items()):
            if frames and (self.now_s + 30 * index) % self.period_s == 0:
                link.offer(self.frame(self.now_s))
                self.sent[name].append(self.now_s)
            for second in (0, 15):
                self._step(name, link, health, self.now_s + second)
                self._map_step()

    def frame(self, second: int) -> OutboxFrame:
        view = second // self.period_s % len(self._messages)
        return OutboxFrame(CAMERA, stamp_of(second), view, "", stamped(self._messages[view], stamp_of(second)))

    def _step(self, name: str, link: TowerLink, health: Health, now_s: float) -> None:
        try:
            if f"outbox {name}" in self._mended:
                raise StoreError("the disk is away")
            link.step(now_s)
        except StoreError as error:
            health.trouble("store", str(error))

    def _map_step(self) -> None:
        persistence = self._map.aggregator.persistence
        if "store" in self._mended:
            persistence.store.commit = _away  # type: ignore[union-attr,method-assign]
        else:
            vars(persistence.store).pop("commit", None)
        persistence.wait(10.0)
        self._map.step(0.0)

    def _fault(self) -> None:
        kind = self._draws.choice(FAULTS)
        self.faults[kind] += 1
        until = self.now_s + self._draws.randrange(60, LONGEST_FAULT_S)
        if kind == "link":
            self._mended[f"line {self._draws.choice(self._broker.links).name}"] = until
        elif kind == "tower":
            name = self._draws.choice(list(self._towers))
            link, health = self._towers[name]
            # What was offered and is not yet in the file is no frame that anybody was told to be kept.
            self._step(name, link, health, self.now_s)
            if f"outbox {name}" not in self._mended:
                self._let_go(link, health)
                self._towers[name] = self._tower(name)
        elif kind == "map":
            self._broker.end(f"{REGION}-{AGGREGATOR}")
            assert self._map.aggregator.persistence.store is not None
            self._map.aggregator.persistence.store.close()
            self.dropped += Counter(self._map_health.dropped)
            self._map = self._made_map()
        elif kind == "broker":
            self._broker.restart()
        elif kind in ("outbox", "store"):
            self._mended[kind if kind == "store" else f"outbox {self._draws.choice(list(self._towers))}"] = until
        else:
            self._broker.fault = kind
