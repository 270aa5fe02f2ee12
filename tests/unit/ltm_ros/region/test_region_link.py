import ssl
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from rclpy.serialization import deserialize_message
from scenes.free_port import free_port
from scenes.fuel_frames import LABELS
from scenes.mqtt_broker import Broker
from scenes.region_scene import CAMERA, REGION, RegionScene, same_map, stamp_of, write_region_scene
from scenes.waiting import PATIENCE_S, wait_for
from sensor_msgs.msg import PointCloud2

from ltm_core.base.errors import StoreError
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, open_stored_map
from ltm_core.uplink.config import UplinkConfig
from ltm_core.uplink.envelope import VotesGrid
from ltm_core.uplink.outbox_io import Outbox, OutboxFrame
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_ros.region.certs import TrialAuthority
from ltm_ros.region.mqtt_link import (
    LARGEST_PACKET,
    ack_topic,
    hand_over,
    presence_topic,
    votes_topic,
)
from ltm_ros.region.service import RegionService, RegionWatch
from ltm_ros.region.tower_link import TowerLink
from ltm_ros.runtime.health import Health


@pytest.fixture
def scene(tmp_path: Path) -> RegionScene:
    return write_region_scene(tmp_path, free_port())


@pytest.fixture
def broker(scene: RegionScene) -> Iterator[Broker]:
    with Broker(scene.certs / "mosquitto.conf", scene.port) as running:
        yield running


class Service:
    def __init__(self, scene: RegionScene) -> None:
        self.health = Health()
        self.service = RegionService(scene.config, self.health)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self.service.run, args=(self._stopping,))
        self._thread.start()

    @property
    def frames(self) -> int:
        return self.service.aggregator.persistence.saved_frames

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join()


@contextmanager
def mapped(scene: RegionScene) -> Iterator[Service]:
    service = Service(scene)
    try:
        yield service
    finally:
        service.stop()


@contextmanager
def sending(scene: RegionScene, name: str, **changes: Any) -> Iterator[tuple[TowerLink, Health]]:
    """A tower whose clock nobody keeps right; `changes`: of what it says of its grid."""
    config, health = UplinkConfig(name=REGION, tower=name, broker=scene.broker(name)), Health()
    grid = VotesGrid(**scene.grid.model_dump() | changes)
    link = TowerLink(config, grid, scene.folder / f"{name}.sqlite", health, lambda: None)
    link.start()
    try:
        yield link, health
    finally:
        link.stop()


def offer(link: TowerLink, scene: RegionScene, numbers: range) -> None:
    for number in numbers:
        link.offer(OutboxFrame(CAMERA, stamp_of(number), 0, "", scene.votes(number)))


def waiting(health: Health) -> str:
    return health.summary().get("outbox_frames", "")


def test_frames_reach_the_map_and_leave_the_outbox(scene: RegionScene, broker: Broker) -> None:
    with sending(scene, "alta") as (alta, said), sending(scene, "bear") as (bear, _):
        offer(alta, scene, range(30))
        offer(bear, scene, range(9))
        wait_for(lambda: waiting(said) == "30", "the outbox")
        summary = said.summary()
        assert float(summary["outbox_bytes"]) == sum(len(scene.votes(number)) for number in range(30))
        assert float(summary["outbox_age_s"]) == pytest.approx(time.time() - stamp_of(0) / 1e9, abs=60)
        with mapped(scene) as service:
            wait_for(lambda: service.frames == 39, "all frames")
            wait_for(lambda: waiting(said) == "0", "an empty outbox")
            assert said.summary()["noted.acknowledged"] == "30"
            assert said.summary()["outbox_age_s"] == "0.0"
            broker.stop()
            offer(alta, scene, range(30, 40))
            wait_for(lambda: waiting(said) == "10", "the outbox again")
            broker.start()
            wait_for(lambda: service.frames == 49 and waiting(said) == "0", "the rest")
            assert (service.health.dropped, said.dropped) == ({}, {})


def test_after_kills_of_map_and_broker_the_map_is_that_of_all_frames(scene: RegionScene, broker: Broker) -> None:
    """With SIGKILL, while the map counts. Kills of a tower are in `test_outbox.py`."""
    frames, source = 100, f"alta_{CAMERA}"
    command = [sys.executable, "-m", "ltm_ros.cli.main", "region", str(scene.folder / "region.yaml")]
    with sending(scene, "alta") as (alta, said):
        offer(alta, scene, range(frames))
        wait_for(lambda: waiting(said) == str(frames), "the outbox")
        for left in (frames // 2, 0):
            with subprocess.Popen(command) as service:
                wait_for(lambda left=left: int(waiting(said)) <= left, "answers of the map")  # type: ignore[misc]
                service.kill()
            broker.stop()
            broker.start()
        assert said.dropped == {}
    found, expected = (site_evidence_map(scene.site, scene.geometry, LABELS) for _ in range(2))
    for number in range(frames):
        message = deserialize_message(scene.votes(number), PointCloud2)
        expected.add(msg_to_votes(message, scene.geometry, LABELS.names, source))
    with open_stored_map(scene.folder / "map" / STORE_FILE, scene.site, found) as opened:
        assert opened.sources() == {source: frames}
    assert same_map(found, expected)


def test_a_disk_that_does_not_serve_holds_up_no_frame_that_lies_on_it(
    scene: RegionScene, broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Full: nothing can be put, nor let go of. What is stored there is sent all the same, and but once."""
    with sending(scene, "alta") as (alta, said):
        offer(alta, scene, range(5))
        wait_for(lambda: waiting(said) == "5", "the outbox")

        def full(*_: object) -> int:
            raise StoreError("the disk is full")

        with monkeypatch.context() as patched:
            patched.setattr(Outbox, "put", full)
            patched.setattr(Outbox, "acknowledge", full)
            offer(alta, scene, range(5, 8))
            with mapped(scene) as service:
                wait_for(lambda: service.frames == 5, "the frames on the disk")
                time.sleep(1.5)
                assert "noted.duplicate" not in service.health.summary()
        with mapped(scene) as service:
            wait_for(lambda: service.frames == 8 and waiting(said) == "0", "the others")
            assert said.summary()["noted.acknowledged"] == "8"


class Client:
    """A client of the broker that keeps to no rule of ours. `name`: of its certificate; empty: it has none."""

    def __init__(self, scene: RegionScene, name: str, folder: Path | None = None, client_id: str = "") -> None:
        self.reasons: list[str] = []
        self.got: list[tuple[str, bytes]] = []
        self.connected = threading.Event()
        self._mqtt = mqtt.Client(CallbackAPIVersion.VERSION2, client_id=client_id, protocol=mqtt.MQTTv5)
        context = ssl.create_default_context(cafile=str(scene.certs / "ca.crt"))
        if name:
            place = folder or scene.certs
            context.load_cert_chain(place / f"{name}.crt", place / f"{name}.key")
        self._mqtt.tls_set_context(context)
        self._mqtt.on_connect = lambda *_: self.connected.set()
        self._mqtt.on_publish = lambda _c, _d, _m, reason, _p: self.reasons.append(str(reason))
        self._mqtt.on_message = lambda _c, _d, message: self.got.append((message.topic, bytes(message.payload)))
        self._mqtt.connect_async("127.0.0.1", scene.port)
        self._mqtt.loop_start()

    def publish(self, topic: str, payload: bytes, qos: int = 1, retain: bool = False) -> None:
        self._mqtt.publish(topic, payload, qos, retain)

    def subscribe(self, topic: str) -> None:
        self._mqtt.subscribe(topic, 0)

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self._mqtt.disconnect()
        self._mqtt.loop_stop()


def test_nobody_comes_without_a_certificate_of_the_authority(
    scene: RegionScene, broker: Broker, tmp_path: Path
) -> None:
    TrialAuthority(tmp_path / "others", days=2).make(REGION, ["alta"], ["127.0.0.1"], "127.0.0.1", 8883)
    with Client(scene, "") as nobody, Client(scene, "alta", tmp_path / "others") as stranger:
        with Client(scene, "alta") as alta:
            assert alta.connected.wait(PATIENCE_S)
        wait_for(lambda: broker.log.count("OpenSSL Error") >= 2, "refusals")
        assert not nobody.connected.is_set()
        assert not stranger.connected.is_set()


def test_a_tower_writes_its_own_topic_alone_and_hears_what_is_its_own(scene: RegionScene, broker: Broker) -> None:
    topics = [
        votes_topic(REGION, "bear"),
        ack_topic(REGION, "bear"),
        f"ltm/{REGION}/aggregator",
    ]
    with Client(scene, "alta") as alta, Client(scene, "bear") as bear:
        assert alta.connected.wait(PATIENCE_S)
        assert bear.connected.wait(PATIENCE_S)
        alta.subscribe("#")
        bear.publish(votes_topic(REGION, "bear"), b"mine")
        wait_for(lambda: len(bear.reasons) == 1, "an answer")
        for topic in topics:
            alta.publish(topic, b"not mine")
        wait_for(lambda: len(alta.reasons) == len(topics), "answers")
        assert set(alta.reasons) == {"Not authorized"}
        assert "Not authorized" not in bear.reasons
        assert alta.got == []


def test_nobody_ends_the_connection_of_another_by_its_name(scene: RegionScene, broker: Broker) -> None:
    with sending(scene, "alta") as (_, said), mapped(scene):
        wait_for(lambda: said.summary().get("link_up") == "1", "the link")
        with Client(scene, "bear", client_id=f"{REGION}-alta") as bear:
            assert bear.connected.wait(PATIENCE_S)
            time.sleep(0.5)
        assert "noted.link_lost" not in said.summary()


def test_an_acknowledgement_that_is_forged_or_replayed_lets_nothing_go(scene: RegionScene, broker: Broker) -> None:
    """As if the broker itself were the enemy: it can say what it likes on any topic, but sign nothing."""
    body = f'{{"outcomes": [{{"camera": "{CAMERA}", "stamp_ns": {stamp_of(0)}, "done": true}}]}}'.encode()
    header = f'{{"version": 1, "region": "{REGION}", "tower": "alta"}}'.encode()
    by_tower = scene.identity("bear").sealed(header, body)
    for_bear = scene.identity("aggregator").sealed(header.replace(b"alta", b"bear"), body)
    with sending(scene, "alta") as (alta, said), Client(scene, "aggregator") as enemy:
        offer(alta, scene, range(1))
        enemy.publish(presence_topic(REGION), b"some life", retain=True)
        wait_for(lambda: said.summary().get("link_up") == "1", "the link")
        for number, content in enumerate([b"junk", by_tower, for_bear], start=1):
            enemy.publish(ack_topic(REGION, "alta"), content)
            wait_for(lambda number=number: said.dropped.get("message") == number, "it is counted")
        assert waiting(said) == "1"


def resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


@pytest.mark.parametrize("megabytes", [15, pytest.param(1000, marks=pytest.mark.slow)])
def test_junk_is_refused_and_counted_in_bounded_memory(scene: RegionScene, broker: Broker, megabytes: int) -> None:
    with mapped(scene) as service, Client(scene, "alta") as alta, sending(scene, "bear") as (bear, said):
        assert alta.connected.wait(PATIENCE_S)
        wait_for(lambda: said.summary().get("link_up") == "1", "the map is there")
        before = resident_mb()
        junk = np.random.default_rng(1).bytes(90_000)
        for number in range(megabytes * 10**6 // len(junk)):
            alta.publish(votes_topic(REGION, "alta"), junk, qos=1)
            if number % 200 == 0:
                wait_for(lambda number=number: len(alta.reasons) >= number - 200, "the broker")
        offer(bear, scene, range(3))
        wait_for(lambda: service.frames == 3, "the votes of the other tower")
        refused = service.health.dropped
        assert 0 < refused["message"] <= megabytes * 10**6 // len(junk)
        assert resident_mb() - before < 250
        # A packet that is larger than any of ours ends its sender's connection, and nobody else hears of it.
        with Client(scene, "desk") as other:
            assert other.connected.wait(PATIENCE_S)
            other.publish(votes_topic(REGION, "desk"), bytes(LARGEST_PACKET + 1000), qos=0)
            wait_for(lambda: "oversize packet" in broker.log or "Packet too large" in broker.log, "the broker's word")


def test_a_topic_that_is_no_text_is_counted(scene: RegionScene) -> None:
    message, health, got = mqtt.MQTTMessage(topic=b"ltm/\xff\xfe"), Health(), []
    hand_over(message, lambda topic, payload: got.append(topic), health)
    assert (got, health.dropped) == ([], {"message": 1})
    message.topic = b"ltm/kern/votes/alta"
    hand_over(message, lambda topic, payload: got.append(topic), health)
    assert got == ["ltm/kern/votes/alta"]


def test_the_region_answers_monitoring_systems(scene: RegionScene, broker: Broker) -> None:
    port, site = free_port(), scene.config.site
    site.write_text(f"{site.read_text()}health: {{port: {port}}}\n")
    with mapped(scene) as service, sending(scene, "alta") as (alta, _):
        watch = RegionWatch(scene.config, service.service, service.health)
        try:
            offer(alta, scene, range(5))
            service.health.drop("message", "somebody's junk", 3)

            def metrics() -> str:
                return str(urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics").read().decode())

            said = 'ltm_node_value{camera="",name="frames",node="/kern_map/region"} 5.0'
            wait_for(lambda: f"\n{said}\n" in metrics(), said, metrics)
            assert 'ltm_dropped_total{camera="",cause="message",node="/kern_map/region"} 3.0' in metrics()
        finally:
            watch.close()
