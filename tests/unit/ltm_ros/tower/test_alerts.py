import contextlib
import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from scenes.free_port import free_port
from scenes.waiting import wait_for

from ltm_core.base.errors import LtmError
from ltm_core.site.sections import AlertsConfig
from ltm_core.site.source_config import SecretConfig
from ltm_ros.runtime.health import Health
from ltm_ros.tower.alerts import HOLD_S, AlertQueue, AlertSender, ChangeWatch, post, publish
from ltm_ros.tower.machine import Condition

ALIVE, STALLED = Condition("camera", "north", "alive", ""), Condition("camera", "north", "stalled", "north: no frame")
MISSING = Condition("node", "north/depth", "missing", "/ridge/north/depth no report yet")
REPORTS = Condition("node", "north/depth", "ok", "")
START_S = 600.0
TOKEN = "s3cret/&token"


def heard(states: list[tuple[float, Condition]]) -> list[tuple[str | None, str, bool, float]]:
    """Return (previous, state, problem, since in seconds after the start) of each message but the first."""
    watch, said = ChangeWatch("ridge", START_S), []
    for now_s, condition in states:
        said += list(watch.messages([condition], now_s, 1_750_000_000.0 + now_s))
    first, *rest = said
    assert (first["kind"], first["state"], first["since"]) == ("tower", "started", "2025-06-15T15:06:40Z")
    since = [datetime.fromisoformat(message["since"]).timestamp() - 1_750_000_000.0 for message in rest]
    return [(m["previous"], m["state"], m["problem"], begin) for m, begin in zip(rest, since, strict=True)]


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        ([(0, MISSING), (599, MISSING), (601, REPORTS), (640, REPORTS)], []),
        ([(0, MISSING), (600, MISSING)], [(None, "missing", True, 0)]),
        ([(0, ALIVE), (HOLD_S, ALIVE)], []),
        ([(0, STALLED), (HOLD_S, STALLED), (99, STALLED)], [(None, "stalled", True, 0)]),
        ([(0, ALIVE), (40, ALIVE), (50, STALLED), (79, STALLED), (79.5, ALIVE), (150, ALIVE)], []),
        (
            [(0, ALIVE), (40, ALIVE), (50, STALLED), (80, STALLED), (90, ALIVE), (120, ALIVE)],
            [("alive", "stalled", True, 50), ("stalled", "alive", False, 90)],
        ),
    ],
    ids=["a slow start", "no start", "fine", "begins with a problem", "a short failure", "a failure and its end"],
)
def test_a_state_is_sent_once_after_it_has_lasted(
    states: list[tuple[float, Condition]], expected: list[tuple[str | None, str, bool, float]]
) -> None:
    assert heard(states) == expected


@dataclass
class Receiver:
    """A webhook that answers with the given statuses, then with 200."""

    statuses: list[int] = field(default_factory=list)
    requests: list[tuple[str, str | None, bytes]] = field(default_factory=list)
    port: int = 0


@contextlib.contextmanager
def receiving(*statuses: int) -> Iterator[Receiver]:
    receiver = Receiver(list(statuses))

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            receiver.requests.append((self.path, self.headers["authorization"], body))
            self.send_response(receiver.statuses.pop(0) if receiver.statuses else 200)
            self.send_header("location", "http://127.0.0.1:9/elsewhere")
            self.send_header("content-length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None: ...

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        receiver.port = server.server_port
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield receiver
        finally:
            server.shutdown()


def test_a_webhook_gets_every_message_in_order_although_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOOK", TOKEN)
    health = Health()
    with receiving(500, 302) as receiver:
        url = f"http://127.0.0.1:{receiver.port}/hook"
        secret = SecretConfig(environment="HOOK")
        queue = AlertQueue("webhook", lambda content: post(url, secret, content), health, first_retry_s=0.01)
        for number in range(3):
            queue.offer({"number": number})
        wait_for(lambda: len(receiver.requests) == 5, "all messages", lambda: receiver.requests)
        wait_for(lambda: health.summary().get("noted.alert_sent") == "3", "their count", health.summary)
        queue.close()
    assert [json.loads(body)["number"] for _, _, body in receiver.requests] == [0, 0, 0, 1, 2]
    assert {login for _, login, _ in receiver.requests} == {f"Bearer {TOKEN}"}
    assert "HTTP 302" in health.last_error
    assert health.dropped == {}


def test_a_token_in_the_url_is_filled_in_and_never_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOOK", TOKEN)
    secret = SecretConfig(environment="HOOK")
    with receiving() as receiver:
        post(f"http://127.0.0.1:{receiver.port}/{{token}}", secret, b"{}")
    assert receiver.requests == [("/s3cret%2F%26token", None, b"{}")]
    with pytest.raises(LtmError) as told:
        post(f"http://127.0.0.1:{free_port()}/{{token}}", secret, b"{}")
    assert "s3cret" not in str(told.value)
    monkeypatch.delenv("HOOK")
    with pytest.raises(LtmError, match="HOOK"):
        post("http://127.0.0.1:9/", secret, b"{}")


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[tuple[AlertsConfig, Callable[[], list[Any]]]]:
    """Yield a broker that requires TLS with certificates, and a function that returns what a subscriber received."""
    mqtt = pytest.importorskip("paho.mqtt.client", reason="the extra `region` is not installed")
    from scenes.mqtt_broker import Broker

    from ltm_ros.region.certs import TrialAuthority

    port, folder = free_port(), tmp_path / "certs"
    TrialAuthority(folder, 5).make("ridges", ["ridge", "desk"], ["127.0.0.1"], "127.0.0.1", port)
    (tmp_path / "mosquitto.conf").write_text(
        f"listener {port} 127.0.0.1\nrequire_certificate true\nallow_anonymous true\ncafile {folder}/ca.crt\n"
        f"certfile {folder}/broker.crt\nkeyfile {folder}/broker.key\nuser root\n"
    )
    received: list[Any] = []
    with Broker(tmp_path / "mosquitto.conf", port):
        desk = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        desk.tls_set(f"{folder}/ca.crt", f"{folder}/desk.crt", f"{folder}/desk.key")
        desk.on_message = lambda _client, _data, message: received.append((message.topic, json.loads(message.payload)))
        subscribed = threading.Event()
        desk.on_subscribe = lambda *_: subscribed.set()
        desk.on_connect = lambda client, *_: client.subscribe("ltm/+/alerts", 1)
        desk.connect("127.0.0.1", port)
        desk.loop_start()
        assert subscribed.wait(20)
        yield (
            AlertsConfig(
                mqtt=f"mqtts://127.0.0.1:{port}",
                ca=folder / "ca.crt",
                certificate=folder / "ridge.crt",
                key=folder / "ridge.key",
            ),
            lambda: received,
        )
        desk.disconnect()
        desk.loop_stop()


def test_a_broker_gets_the_messages(broker: tuple[AlertsConfig, Callable[[], list[Any]]]) -> None:
    config, received = broker
    sender = AlertSender(config, "ridge", START_S, Health())
    for now_s in (0.0, HOLD_S):
        sender.look([STALLED], now_s, 1_750_000_000.0)
    wait_for(lambda: len(received()) == 2, "both messages", received)
    sender.close()
    assert {topic for topic, _ in received()} == {"ltm/ridge/alerts"}
    assert [(m["state"], m["problem"]) for _, m in received()] == [("started", False), ("stalled", True)]
    with pytest.raises(LtmError):  # without its certificate
        publish(config.model_copy(update={"certificate": None, "key": None}), "other", b"{}")
    with pytest.raises(LtmError, match="not reachable"):
        publish(AlertsConfig(mqtt=f"mqtt://127.0.0.1:{free_port()}"), "other", b"{}")


def test_a_bug_in_a_delivery_loses_no_message(capsys: pytest.CaptureFixture[str]) -> None:
    taken, health = list[bytes](), Health()

    def deliver(content: bytes) -> None:
        taken.append(content)
        if len(taken) == 1:
            raise ZeroDivisionError("password=hunter2")

    queue = AlertQueue("webhook", deliver, health, first_retry_s=0.01)
    queue.offer({"number": 1})
    wait_for(lambda: len(taken) == 2, "another attempt", lambda: taken)
    queue.close()
    assert "internal error" in health.last_error
    assert "hunter2" not in capsys.readouterr().err
