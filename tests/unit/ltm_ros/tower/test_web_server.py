import base64
import errno
import http.client
import os
import shutil
import socket
import ssl
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest
from pydantic import ValidationError

from ltm_core.base.errors import ConfigError
from ltm_core.site.sections import HealthConfig
from ltm_ros.runtime.web_server import CONNECTIONS, WebResponse, WebServer
from ltm_ros.tower.health_client import ask, open_health_server

TOKEN = "0123456789abcdef-token"
ROUTES = {
    "GET /healthz": lambda _: WebResponse(b"alive\n"),
    "GET /status.json": lambda _: WebResponse.json({"ready": True}),
    "POST /mark": lambda body: WebResponse(b"taken: " + body),
}
Start = Callable[..., WebServer]


@pytest.fixture
def start() -> Iterator[Start]:
    servers: list[WebServer] = []

    def start(**keys: object) -> WebServer:
        servers.append(open_health_server(HealthConfig.model_validate({"port": 0} | keys), ROUTES))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


def get(
    server: WebServer,
    path: str,
    headers: dict[str, str] | None = None,
    method: str = "GET",
    address: str = "127.0.0.1",
    body: bytes | None = None,
) -> tuple[int, bytes]:
    with closing(http.client.HTTPConnection(address, server.port, timeout=10)) as connection:
        connection.request(method, path, body, headers or {})
        answer = connection.getresponse()
        return answer.status, answer.read()


def config_for(server: WebServer, **keys: object) -> HealthConfig:
    return HealthConfig.model_validate({"port": server.port} | keys)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl, for a certificate")
    folder = tmp_path_factory.mktemp("certificate")
    files = folder / "tower.pem", folder / "tower.key"
    subject = ["-subj", "/CN=tower", "-addext", "subjectAltName=IP:127.0.0.1"]
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    subprocess.run(
        [*command, "-days", "2", "-out", files[0], "-keyout", files[1], *subject], check=True, capture_output=True
    )
    return files


@pytest.fixture
def token(tmp_path: Path) -> Path:
    path = tmp_path / "health-token"
    path.write_text(f"{TOKEN}\n")
    return path


def test_answers_on_loopback(start: Start) -> None:
    server = start()
    assert get(server, "/healthz") == (200, b"alive\n")
    assert get(server, "/healthz?verbose") == (200, b"alive\n")
    assert get(server, "/healthz", method="HEAD") == (200, b"")
    assert get(server, "/../../etc/passwd")[0] == 404
    assert get(server, "/healthz", method="DELETE")[0] == 501
    assert ask(config_for(server), "/status.json") == {"ready": True}


def test_a_page_of_another_name_that_leads_here_is_not_answered(start: Start) -> None:
    server = start()
    assert get(server, "/healthz", {"Host": "evil.example"})[0] == 421
    for wrong in ("", "[::1", "127.0.0.1.evil.example", "evil.example:127"):
        assert get(server, "/healthz", {"Host": wrong})[0] == 421
    for right in ("localhost", f"localhost:{server.port}", f"LocalHost:{server.port}", "127.0.0.1"):
        assert get(server, "/healthz", {"Host": right})[0] == 200


def test_answers_on_loopback_of_the_next_protocol(start: Start) -> None:
    addresses = Path("/proc/net/if_inet6")
    if not addresses.exists() or not addresses.read_text():
        pytest.skip("no IPv6 on this machine")
    server = start(address="0:0:0:0:0:0:0:1")
    for host in ("[::1]", f"[::1]:{server.port}", "localhost"):
        assert get(server, "/healthz", {"Host": host}, address="::1") == (200, b"alive\n")
    assert get(server, "/healthz", {"Host": "[::2]"}, address="::1")[0] == 421
    assert ask(config_for(server, address="::1"), "/status.json") == {"ready": True}


def test_a_token_is_asked_for_where_there_is_one(start: Start, token: Path) -> None:
    server = start(token=token)
    for wrong in ("", "Bearer", f"Bearer {TOKEN}x", f"Basic {TOKEN}", "Basic !!", "Bearer \xe4"):
        assert get(server, "/healthz", {"Authorization": wrong.encode("latin-1")})[0] == 401  # type: ignore[dict-item]
    assert get(server, "/healthz", {"Authorization": f"Bearer {TOKEN}"}) == (200, b"alive\n")
    basic = base64.b64encode(f"anybody:{TOKEN}".encode()).decode()
    assert get(server, "/healthz", {"Authorization": f"Basic {basic}"}) == (200, b"alive\n")
    assert ask(config_for(server, token=token), "/status.json") == {"ready": True}


def test_tls(start: Start, certificate: tuple[Path, Path], token: Path) -> None:
    server = start(certificate=certificate[0], key=certificate[1], token=token)
    with pytest.raises((OSError, http.client.HTTPException)):
        get(server, "/healthz")  # in clear text
    keys = {"certificate": certificate[0], "key": certificate[1], "token": token}
    assert ask(config_for(server, **keys), "/status.json") == {"ready": True}
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as plain:
        old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        old.check_hostname, old.verify_mode = False, ssl.CERT_NONE
        with pytest.warns(DeprecationWarning, match="TLS"):
            old.maximum_version = ssl.TLSVersion.TLSv1_1
        with pytest.raises(OSError):
            old.wrap_socket(plain)


def test_who_holds_all_connections_is_let_go_of_and_others_are_answered_again(start: Start) -> None:
    server = start()
    idle = [socket.create_connection(("127.0.0.1", server.port), timeout=10) for _ in range(CONNECTIONS)]
    for one in idle:
        one.sendall(b"GET /healthz HTTP/1.0\r\n")  # and never the rest
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as late:
        late.sendall(b"GET /healthz HTTP/1.0\r\n\r\n")
        with suppress(ConnectionResetError):
            assert late.recv(100) == b"", "closed at once, no thread waits for it"
    for one in idle:
        one.close()
    assert get_again(server) == (200, b"alive\n")


def get_again(server: WebServer) -> tuple[int, bytes]:
    """Until a place is free again."""
    while True:
        try:
            return get(server, "/healthz")
        except (OSError, http.client.HTTPException):
            continue


@pytest.mark.parametrize("secured", [False, True])
def test_who_drips_is_let_go_of_though_something_always_comes(
    start: Start, certificate: tuple[Path, Path], token: Path, monkeypatch: pytest.MonkeyPatch, secured: bool
) -> None:
    monkeypatch.setitem(WebServer.__init__.__kwdefaults__, "request_s", 1.0)
    keys = {"certificate": str(certificate[0]), "key": str(certificate[1]), "token": str(token)} if secured else {}
    server = start(**keys)
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as plain:
        context = ssl.create_default_context(cafile=certificate[0])
        # By TLS it needs no token for that.
        dripping = context.wrap_socket(plain, server_hostname="127.0.0.1") if secured else plain
        dripping.sendall(b"GET /healthz HTTP/1.0\r\nX: ")
        dripping.settimeout(0.1)
        for _ in range(200):
            try:
                dripping.sendall(b"a")
                assert dripping.recv(1) == b""
                break
            except TimeoutError:
                continue
            except OSError:
                break
        else:
            pytest.fail("it may hold its place for ever")


def test_an_answer_that_a_bug_or_the_machine_prevents_says_so_and_is_in_the_log(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def no_descriptors(_: bytes) -> WebResponse:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    def crash(body: bytes) -> WebResponse:
        raise KeyError(f"{len(body)} bytes")

    server = WebServer(
        {
            "GET /status.json": lambda _: WebResponse.json({"age": float("nan")}),
            "GET /metrics": no_descriptors,
            "POST /mark": crash,
        }
    )
    said = (500, b"internal error: see the log\n")
    try:
        assert get(server, "/status.json") == get(server, "/metrics") == said
        assert get(server, "/mark", {"Content-Type": "application/json"}, "POST", body=b"{}") == said
    finally:
        server.close()
    log = capsys.readouterr().err
    for cause in ("Out of range float values are not JSON compliant", os.strerror(errno.EMFILE), "2 bytes"):
        assert cause in log


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"address": "0.0.0.0"}, "reachable from other hosts: give certificate, key and token"),
        ({"address": "192.0.2.1", "token": "t"}, "reachable from other hosts"),
        ({"address": "tower.example"}, "give an IP address"),
        ({"certificate": "a.pem"}, "certificate and key together"),
        ({"port": 70000}, "less than or equal to 65535"),
    ],
)
def test_nobody_is_let_in_by_mistake(keys: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        HealthConfig.model_validate(keys)


def test_a_token_that_is_none_is_refused_and_never_repeated(start: Start, tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text("short-secret")
    with pytest.raises(ConfigError, match="16 characters or more") as error:
        start(token=path)
    assert "short-secret" not in str(error.value)
    with pytest.raises(ConfigError, match="cannot be read"):
        start(token=tmp_path / "none")


JSON = {"Content-Type": "application/json; charset=utf-8"}


def test_what_is_sent_is_taken_where_it_may_be(start: Start) -> None:
    server = start()
    assert get(server, "/mark", JSON, "POST", body=b"{}") == (200, b"taken: {}")
    assert get(server, "/healthz", JSON, "POST", body=b"{}")[0] == 404
    assert get(server, "/mark")[0] == 404, "it is sent to, not asked for"


@pytest.mark.parametrize(
    ("headers", "body", "status"),
    [
        ({"Content-Type": "text/plain"}, b"{}", 415),
        ({"Content-Type": "application/x-www-form-urlencoded"}, b"camera=north", 415),
        (JSON, b"x" * 4097, 413),
        (JSON | {"Content-Length": "-1"}, None, 411),
        (JSON | {"Content-Length": "many"}, None, 411),
        (JSON | {"Transfer-Encoding": "chunked", "Content-Length": "2"}, b"{}", 411),
        (JSON | {"Host": "evil.example"}, b"{}", 421),
        (JSON | {"Origin": "http://evil.example"}, b"{}", 403),
        (JSON | {"Origin": "null"}, b"{}", 403),
    ],
)
def test_pages_of_others_and_too_much_are_not_taken(
    start: Start, headers: dict[str, str], body: bytes | None, status: int
) -> None:
    """A form of somebody else's page comes with whatever the browser knows, but not as JSON."""
    assert get(start(), "/mark", headers, "POST", body=body)[0] == status


def test_the_credential_of_the_service_goes_before_the_file(
    start: Start, token: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "given").mkdir()
    (tmp_path / "given/ltm_health-token").write_text("another-token-of-systemd")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path / "given"))
    server = start(token=token)
    assert get(server, "/healthz", {"Authorization": f"Bearer {TOKEN}"})[0] == 401
    assert get(server, "/healthz", {"Authorization": "Bearer another-token-of-systemd"})[0] == 200
