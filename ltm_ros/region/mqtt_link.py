"""Connect to an MQTT 5 broker and reconnect after losses; define topics, limits and the queue of received messages."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from ltm_core.base.errors import MessageError
from ltm_core.uplink.config import AGGREGATOR, BrokerConfig, UplinkConfig
from ltm_core.uplink.envelope import (
    LARGEST,
    VERSION,
    AckHeader,
    Outcome,
    VotesGrid,
    VotesHeader,
    header_of,
    outcomes_of,
)
from ltm_core.uplink.outbox_io import OutboxFrame
from ltm_ros.region.identity import Identity
from ltm_ros.runtime.health import Health

ROOT: Final = "ltm"
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1, 2
"""First and longest pause in seconds between attempts to connect. A rejected attempt costs about 5 kB, a tenth of what
one camera sends meanwhile."""
LARGEST_PACKET: Final = LARGEST + 1024
"""Maximum bytes of a packet with its topic, which is announced to the broker."""

WITH_WILL: Final = 0x04
"""Reason code of a DISCONNECT after which the will is published (MQTT 5, 3.14.2.1)."""

Taker = Callable[[str, bytes], None]
"""Receives topic and payload in the connection's thread; must be quick and must not raise."""


def votes_topic(region: str, tower: str) -> str:
    return f"{ROOT}/{region}/votes/{tower}"


def ack_topic(region: str, tower: str) -> str:
    return f"{ROOT}/{region}/ack/{tower}"


def presence_topic(region: str) -> str:
    """Return the retained topic with the run number of the active aggregator; empty without one."""
    return f"{ROOT}/{region}/aggregator"


def hand_over(message: mqtt.MQTTMessage, take: Taker, health: Health) -> None:
    """Pass on a received message. A topic that is not UTF-8 is counted; it would end the connection's thread."""
    try:
        topic = message.topic
    except UnicodeDecodeError as error:
        health.drop("message", f"the broker sent a message on a topic that is not UTF-8 ({error})")
        return
    take(topic, bytes(message.payload))


class MqttLink:
    """Connects in the background after `start`, and again after each loss.

    Votes and acknowledgements use QoS 0, because senders repeat them. `client_id`: unique among the
    broker's clients. `topics`: subscriptions, whose messages `take` receives. `will`: topic and payload that the broker
    publishes, retained, when this connection is lost."""

    def __init__(
        self,
        config: BrokerConfig,
        identity: Identity,
        client_id: str,
        topics: Sequence[str],
        take: Taker,
        health: Health,
        will: tuple[str, bytes] | None = None,
    ) -> None:
        self._config, self._topics, self._take, self._health = config, topics, take, health
        self.connected = threading.Event()
        """Set while the broker answers and has accepted our subscriptions."""
        self.connections = 0
        """Number of connections so far."""
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id=client_id, protocol=mqtt.MQTTv5)
        self._client.tls_set_context(identity.tls())
        self._client.reconnect_delay_set(FIRST_PAUSE_S, LONGEST_PAUSE_S)
        self._client.max_queued_messages_set(10_000)
        if will is not None:
            self._client.will_set(will[0], will[1], qos=1, retain=True)
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = self._on_connect_fail
        self._client.on_disconnect = self._on_disconnect
        self._client.on_subscribe = self._on_subscribe
        self._client.on_message = lambda _client, _data, message: hand_over(message, take, health)

    def start(self) -> None:
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.MaximumPacketSize = LARGEST_PACKET
        self._client.connect_async(
            self._config.host, self._config.port, self._config.keepalive, clean_start=True, properties=properties
        )
        self._client.loop_start()

    def stop(self) -> None:
        """Disconnect; the broker publishes the will, and queued messages are dropped."""
        self._client.disconnect(reasoncode=ReasonCode(PacketTypes.DISCONNECT, identifier=WITH_WILL))
        self._client.loop_stop()

    def send(self, topic: str, payload: bytes, retain: bool = False) -> bool:
        """Send a message; return whether it was handed over. It may still get lost."""
        if not self.connected.is_set():
            return False
        return self._client.publish(topic, payload, retain=retain).rc == mqtt.MQTT_ERR_SUCCESS

    def _on_connect(self, client: mqtt.Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self._tell(f"the broker rejected the connection: {reason}")
        elif self._topics:
            client.subscribe([(topic, 0) for topic in self._topics])
        else:
            self._ready()

    def _on_subscribe(self, _client: Any, _data: Any, _number: Any, reasons: Any, _properties: Any) -> None:
        if refused := [str(reason) for reason in reasons if reason.is_failure]:
            self._tell(f"the broker rejected the subscriptions to {', '.join(self._topics)}: {', '.join(refused)}")
        else:
            self._ready()

    def _ready(self) -> None:
        self.connections += 1
        self.connected.set()

    def _on_connect_fail(self, _client: Any, _data: Any) -> None:
        self._tell("no connection")

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if self.connected.is_set():
            self._health.note("link_lost")
        self.connected.clear()
        if reason.is_failure:
            self._tell(f"connection lost: {reason}")

    def _tell(self, what: str) -> None:
        self._health.trouble("link", f"broker {self._config.host}:{self._config.port}: {what}")


def sealed_votes(identity: Identity, config: UplinkConfig, grid: VotesGrid, frame: OutboxFrame) -> bytes:
    """Return a frame's envelope. Raises MessageError if it would be too large, ValidationError for invalid names."""
    header = VotesHeader(
        region=config.name,
        tower=config.tower,
        camera=frame.camera,
        stamp_ns=frame.stamp_ns,
        model=frame.model,
        grid=grid,
    )
    return identity.sealed(header.model_dump_json().encode(), frame.message)


def outcomes_heard(identity: Identity, config: UplinkConfig, content: bytes) -> list[Outcome]:
    """Parse an acknowledgement. Raises MessageError if it is not from the aggregator, for this tower."""
    envelope = identity.opened(content, AGGREGATOR)
    header = header_of(AckHeader, envelope)
    if (header.region, header.tower, header.version) != (config.name, config.tower, VERSION):
        raise MessageError(
            f"an acknowledgement has version {header.version} for {header.tower} in {header.region}; this is "
            f"{config.tower} in {config.name}, version {VERSION}"
        )
    return outcomes_of(envelope)


def tell_what_waits(health: Health, frames: int, size: int, oldest_ns: int | None, now_ns: int, link_up: bool) -> None:
    """Set the gauges of a tower's queue for monitoring; `size`: bytes, `oldest_ns`: a stamp."""
    age_s = 0.0 if oldest_ns is None else max(0.0, (now_ns - oldest_ns) / 1e9)
    health.gauge("outbox_frames", frames)
    health.gauge("outbox_bytes", size)
    health.gauge("outbox_age_s", f"{age_s:.1f}")
    health.gauge("link_up", int(link_up))


WAITING_BYTES: Final = 64 << 20
"""Maximum bytes of all queued messages; above it, the newest message of the tower with most data is dropped, and sent
again by it."""
KEPT_BYTES: Final = 1000
"""Overhead in bytes of a queued message, so that empty messages cannot fill the memory."""
LONGEST_NAME: Final = 100
"""Characters kept of an unknown tower's name, which a broker may make 65,000 long."""


class Inbox:
    """`put` is called from the connection's thread, `get` from the counting one.

    Towers take turns, and if the queue is full, the tower with most data loses a message, so that none can delay
    others. `towers`: each has a turn; all other names share one. `most`: maximum bytes in the queue."""

    def __init__(self, towers: Sequence[str], health: Health, most: int = WAITING_BYTES) -> None:
        self._health, self._most = health, most
        self._lanes: dict[str, deque[tuple[str, bytes]]] = {name: deque() for name in [*towers, ""]}
        self._bytes = dict.fromkeys(self._lanes, 0)
        self._turns: deque[str] = deque()
        """Queues with messages, the next one first."""
        self._came = threading.Condition()
        self.bytes = 0
        """Bytes in the queues."""

    def put(self, tower: str, content: bytes) -> None:
        """Queue a message, unless the queue is full and its own tower has most of the data."""
        name, tower = (tower, tower) if tower in self._lanes else ("", tower[:LONGEST_NAME])
        with self._came:
            if not self._lanes[name]:
                self._turns.append(name)
            self._lanes[name].append((tower, content))
            self._account(name, KEPT_BYTES + len(content))
            dropped = []
            while self.bytes > self._most:
                most = max(self._bytes, key=self._bytes.__getitem__)
                gone, content = self._lanes[most].pop()
                self._account(most, -KEPT_BYTES - len(content))
                if not self._lanes[most]:
                    self._turns.remove(most)
                dropped.append(gone if most else "unknown towers")
            self._came.notify()
        for gone in dropped:
            self._health.drop(
                "overload",
                f"{self._most >> 20} MB are queued, most of them from {gone}, which sends the last ones again",
            )

    def get(self, timeout: float) -> tuple[str, bytes] | None:
        """Return tower and content of the next message; None: nothing came in `timeout` seconds."""
        with self._came:
            if not self._turns and not self._came.wait_for(lambda: bool(self._turns), timeout):
                return None
            name = self._turns.popleft()
            tower, content = self._lanes[name].popleft()
            self._account(name, -KEPT_BYTES - len(content))
            if self._lanes[name]:
                self._turns.append(name)
            return tower, content

    def _account(self, lane: str, by: int) -> None:
        self._bytes[lane] += by
        self.bytes += by
