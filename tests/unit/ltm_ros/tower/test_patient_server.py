import http.client
import socket
from contextlib import closing, suppress
from pathlib import Path

import pytest
from scenes.free_port import free_port
from scenes.waiting import wait_for

from ltm_core.site.sections import HealthConfig
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.web_server import WebResponse
from ltm_ros.tower.health_client import PatientServer

ROUTES = {"GET /healthz": lambda _: WebResponse(b"alive\n")}


def answers(port: int) -> bool:
    with suppress(OSError), closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as connection:
        connection.request("GET", "/healthz")
        return connection.getresponse().read() == b"alive\n"
    return False


def test_it_answers_once_the_port_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    health, told, warned = Health(), list[str](), list[str]()
    with socket.create_server(("127.0.0.1", port := free_port())):
        server = PatientServer(HealthConfig(port=port), ROUTES, health, told.append, warned.append, retry_s=0.01)
        assert server.server is None
        assert health.troubled
        assert f"port: 127.0.0.1:{port} cannot be opened (Address already in use)" in health.last_error
        assert (
            f"end the program that uses it (`ss -ltnp 'sport = :{port}'` names it), or choose another"
            in health.last_error
        )
        assert "`health: {port: ..., address: ...}`; retrying every 0.01 s" in health.last_error
        # Said again with each attempt, so that diagnostics say it for as long as it lasts; in the log once.
        monkeypatch.setattr(health, "_last_trouble", -float("inf"))
        wait_for(lambda: health.troubled, "another attempt")
        assert told == []
    wait_for(lambda: server.server is not None, "the port")
    wait_for(lambda: told == [f"health port: http://127.0.0.1:{port}"], "the word of it", lambda: told)
    assert answers(port)
    assert len(warned) == 1
    assert "everything else runs" in warned[0]
    server.close()
    assert not answers(port)


def test_a_token_that_is_corrected_needs_no_restart(tmp_path: Path) -> None:
    """A node that ends would leave the tower without a status page until it is restarted by hand."""
    health, token = Health(), tmp_path / "token"
    config = HealthConfig(port=free_port(), token=token)
    server = PatientServer(config, ROUTES, health, lambda _: None, lambda _: None, retry_s=0.01)
    assert server.server is None
    assert str(token) in health.last_error
    token.write_text("0123456789abcdef")
    wait_for(lambda: server.server is not None, "the port")
    server.close()


def test_an_address_that_the_machine_does_not_have_yet(tmp_path: Path) -> None:
    """That of a tunnel which comes up after the tower: other than a port that is taken, nobody has to end anything."""
    health = Health()
    (tmp_path / "token").write_text("0123456789abcdef")
    config = HealthConfig(port=free_port(), token=tmp_path / "token").model_copy(update={"address": "192.0.2.1"})
    server = PatientServer(config, ROUTES, health, pytest.fail, lambda _: None)
    assert server.server is None
    assert "this machine has no such address now" in health.last_error
    server.close()
