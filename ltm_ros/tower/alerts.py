"""Send a JSON message to a webhook and an MQTT broker for each change of state of a tower.

Each receiver has its own queue and thread, so that neither can delay the other, or the node."""

import json
import random
import ssl
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from typing import Any, Final
from urllib.parse import quote, urlsplit

from ltm_core.base.errors import LtmError, MessageError
from ltm_core.base.redaction import redacted
from ltm_core.site.sections import AlertsConfig
from ltm_core.site.source_config import SecretConfig
from ltm_ros.cameras.protocols.credentials import Login, read_secret
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.retry import Backoff
from ltm_ros.runtime.ros_environment import secret
from ltm_ros.tower.machine import Condition

HOLD_S: Final = 30.0
"""Seconds that a state must last before it is sent, so that a single late frame causes no message."""
STARTING: Final = (("node", "missing"), ("camera", "connecting"))
"""States of nodes and cameras that have not reported yet; they are sent once a start should have ended."""
MOST_QUEUED: Final = 1000
"""Maximum number of undelivered messages of a receiver; the oldest are dropped."""
LONGEST_RETRY_S: Final = 300.0
TIMEOUT_S: Final = 10.0


class ChangeWatch:
    """Turns conditions into messages: one for each state that differs from the last one sent, and has lasted
    `HOLD_S`. States without a problem are assumed at the start, which has a message of its own. `start_s`: time for
    the start, in seconds."""

    def __init__(self, site: str, start_s: float) -> None:
        self._site, self._start_s = site, start_s
        self._started = False
        self._seen: dict[tuple[str, str], tuple[str, float, float]] = {}
        """Latest state, and its begin by the monotonic and by the system clock."""
        self._sent: dict[tuple[str, str], str] = {}

    def messages(self, conditions: Iterable[Condition], now_s: float, time_s: float) -> Iterator[dict[str, Any]]:
        """Yield the messages that are due. `now_s`: by a monotonic clock; `time_s`: by the system clock."""
        if not self._started:
            self._started = True
            yield self._message(Condition("tower", self._site, "started", ""), None, time_s)
        for condition in conditions:
            key = condition.kind, condition.name
            if key not in self._seen or self._seen[key][0] != condition.state:
                self._seen[key] = condition.state, now_s, time_s
            state, begin_s, since_s = self._seen[key]
            before = self._sent.get(key)
            hold_s = self._start_s if (condition.kind, state) in STARTING else HOLD_S
            if state == before or now_s - begin_s < hold_s:
                continue
            self._sent[key] = state
            if before is not None or condition.problem:
                yield self._message(condition, before, since_s)

    def _message(self, condition: Condition, before: str | None, since_s: float) -> dict[str, Any]:
        return {
            "site": self._site,
            "kind": condition.kind,
            "name": condition.name,
            "state": condition.state,
            "previous": before,
            "problem": bool(condition.problem),
            "since": f"{datetime.fromtimestamp(since_s, UTC):%Y-%m-%dT%H:%M:%SZ}",
            "text": condition.problem or f"{condition.kind} {condition.name}: {condition.state}",
        }


class AlertQueue:
    """Delivers messages to one receiver in order, in its own thread, and again after each failure (`deliver` raises
    LtmError)."""

    def __init__(self, name: str, deliver: Callable[[bytes], None], health: Health, first_retry_s: float = 2.0) -> None:
        self._name, self._deliver, self._health = name, deliver, health
        self._queue: deque[bytes] = deque()
        self._backoff = Backoff(first_retry_s, LONGEST_RETRY_S, random.Random())
        self._wake, self._closing = threading.Event(), threading.Event()
        threading.Thread(target=self._run, name=f"alerts {name}", daemon=True).start()

    def offer(self, message: dict[str, Any]) -> None:
        """Queue a message."""
        if len(self._queue) >= MOST_QUEUED:
            self._queue.popleft()
            self._health.drop("alert", f"{self._name}: {MOST_QUEUED} messages are queued; check the receiver")
        self._queue.append(json.dumps(message).encode())
        self._wake.set()

    def close(self) -> None:
        """Stop the thread after the delivery in progress; queued messages are lost."""
        self._closing.set()
        self._wake.set()

    def _run(self) -> None:
        while not self._closing.is_set():
            self._wake.wait()
            self._wake.clear()
            while self._queue and not self._closing.is_set():
                content = self._queue.popleft()
                try:
                    self._deliver(content)
                    self._backoff.succeeded()
                    self._health.note("alert_sent")
                    continue
                except LtmError as error:
                    why = str(error)
                except Exception as error:  # a bug must not end the thread, and with it all later messages
                    print(redacted("".join(traceback.format_exception(error, chain=False))), file=sys.stderr)
                    why = "internal error, see the log"
                self._queue.appendleft(content)
                pause_s = self._backoff.failed()
                self._health.trouble("alert", f"{self._name}: {why}; next attempt in {pause_s:.0f} s")
                self._closing.wait(pause_s)


class AlertSender:
    """Sends the messages of a tower to the receivers of its section `alerts`."""

    def __init__(self, config: AlertsConfig, site: str, start_s: float, health: Health) -> None:
        self._watch = ChangeWatch(site, start_s)
        self._queues = []
        if (url := config.webhook) is not None:
            name = f"webhook {urlsplit(url).netloc}"
            self._queues.append(AlertQueue(name, lambda content: post(url, config.token, content), health))
        if config.mqtt is not None:
            name = f"MQTT broker {urlsplit(config.mqtt).netloc}"
            self._queues.append(AlertQueue(name, lambda content: publish(config, site, content), health))

    def look(self, conditions: Iterable[Condition], now_s: float, time_s: float) -> None:
        """Queue the messages that are due; see `ChangeWatch.messages`."""
        for message in self._watch.messages(conditions, now_s, time_s):
            for queue in self._queues:
                queue.offer(message)

    def close(self) -> None:
        for queue in self._queues:
            queue.close()


def post(url: str, token: SecretConfig | None, content: bytes) -> None:
    """Send a message to a webhook. Raises MessageError if it was not taken, UnauthorisedError without its token."""
    import httpx

    known = None if token is None else read_secret(token)
    value = "" if known is None else known.get_secret_value()
    headers = {"content-type": "application/json", "user-agent": "ltm"}
    if value and "{token}" not in url:
        headers["authorization"] = f"Bearer {value}"
    try:
        # With the system's authorities. A redirect would send the token to another host.
        context = ssl.create_default_context()
        with httpx.Client(timeout=TIMEOUT_S, trust_env=False, follow_redirects=False, verify=context) as client:
            answer = client.post(url.replace("{token}", quote(value, safe="")), headers=headers, content=content)
    except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
        said = Login(None, known).redact(error)
        raise MessageError(f"not reachable ({type(error).__name__}: {said})") from None
    if not answer.is_success:
        raise MessageError(f"answered HTTP {answer.status_code}; check the URL and its token")


def publish(config: AlertsConfig, site: str, content: bytes) -> None:
    """Publish a message, and wait for the broker's acknowledgement. Raises MessageError, or UnauthorisedError if the
    password cannot be read.

    It connects for each message: they are rare, and an open connection would have to be watched."""
    import paho.mqtt.client as mqtt
    from paho.mqtt.enums import CallbackAPIVersion

    url = urlsplit(config.mqtt or "")
    tls = url.scheme == "mqtts"
    client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id=f"ltm-{site}-alerts", protocol=mqtt.MQTTv5)
    client.connect_timeout = TIMEOUT_S
    answers: list[Any] = []
    client.on_connect = lambda _client, _data, _flags, reason, _properties: answers.append(reason)
    try:
        if config.user is not None:
            word = read_secret(config.password).get_secret_value() if config.password else None
            client.username_pw_set(config.user, word)
        if tls:
            context = ssl.create_default_context(cafile=None if config.ca is None else str(config.ca))
            if config.certificate is not None and config.key is not None:
                context.load_cert_chain(config.certificate, secret(config.key))
            client.tls_set_context(context)
        client.connect(url.hostname or "", url.port or (8883 if tls else 1883))
        client.loop_start()
        sent = client.publish(f"ltm/{site}/alerts", content, qos=1)
        sent.wait_for_publish(TIMEOUT_S)
        if not sent.is_published():
            rejected = [str(reason) for reason in answers if reason.is_failure]
            raise MessageError(f"rejected: {rejected[0]}" if rejected else f"no acknowledgement in {TIMEOUT_S:.0f} s")
    except (OSError, ValueError, RuntimeError) as error:
        raise MessageError(f"not reachable ({type(error).__name__}: {error})") from None
    finally:
        client.disconnect()
        client.loop_stop()
