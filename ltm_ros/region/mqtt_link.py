"""Connect to an MQTT 5 broker and reconnect after losses; define topics, limits and the queue of received messages."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from ltm_core.uplink.config import BrokerConfig
from ltm_core.uplink.envelope import LARGEST
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
        self._config, self._topics, self._health = config, topics, health
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
        self._client.on_connect_fail = lambda _client, _data: self._tell("no connection")
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
        else:
            client.subscribe([(topic, 0) for topic in self._topics])

    def _on_subscribe(self, _client: Any, _data: Any, _number: Any, reasons: Any, _properties: Any) -> None:
        if refused := [str(reason) for reason in reasons if reason.is_failure]:
            self._tell(f"the broker rejected the subscriptions to {', '.join(self._topics)}: {', '.join(refused)}")
        else:
            self.connections += 1
            self.connected.set()

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if self.connected.is_set():
            self._health.note("link_lost")
        self.connected.clear()
        if reason.is_failure:
            self._tell(f"connection lost: {reason}")

    def _tell(self, what: str) -> None:
        self._health.trouble("link", f"broker {self._config.host}:{self._config.port}: {what}")


WAITING_BYTES: Final = 4 << 20
"""Maximum bytes of a tower's queued messages, a few times what it has in flight. Further ones are dropped, and
the tower sends them again."""
KEPT_BYTES: Final = 1000
"""Overhead in bytes of a queued message, so that empty messages cannot fill the memory."""
LONGEST_NAME: Final = 100
"""Characters kept of an unknown tower's name, which a broker may make 65,000 long."""


class Inbox:
    """Queues of received messages: `put` is called from the connection's thread, `get` from the counting one.

    Towers take turns, and each has a queue of at most `most` bytes, so that none can delay others. `towers`: all other
    names share one queue."""

    def __init__(self, towers: Sequence[str], health: Health, most: int = WAITING_BYTES) -> None:
        self._health, self._most = health, most
        self._queues: dict[str, deque[tuple[str, bytes]]] = {name: deque() for name in [*towers, ""]}
        """Queues by tower, in the order of their turns."""
        self._bytes = dict.fromkeys(self._queues, 0)
        self._came = threading.Condition()

    @property
    def size(self) -> int:
        """Return the number of bytes in the queues."""
        return sum(self._bytes.values())

    def put(self, tower: str, content: bytes) -> None:
        """Queue a message, unless the queue of its tower is full."""
        name, size = tower if tower in self._queues else "", KEPT_BYTES + len(content)
        with self._came:
            if fits := self._bytes[name] + size <= self._most:
                self._bytes[name] += size
                self._queues[name].append((tower[:LONGEST_NAME], content))
                self._came.notify()
        if not fits:
            self._health.drop(
                "overload", f"{self._most >> 20} MB of {name or 'unknown towers'} are queued; it sends the rest again"
            )

    def get(self, timeout: float) -> tuple[str, bytes] | None:
        """Return tower and content of the next message; None: nothing came in `timeout` seconds."""
        with self._came:
            if not self._came.wait_for(lambda: any(self._queues.values()), timeout):
                return None
            name = next(name for name, waiting in self._queues.items() if waiting)
            waiting = self._queues[name] = self._queues.pop(name)  # the last in turn now
            tower, content = waiting.popleft()
            self._bytes[name] -= KEPT_BYTES + len(content)
            return tower, content
