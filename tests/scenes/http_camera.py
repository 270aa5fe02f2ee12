"""An HTTP camera on loopback, as cameras are: digest and basic authentication with a lock-out, a clock of its own,
conditional requests, snapshots and MJPEG; and everything that they do wrong. `routes` takes more, such as a head's."""

import contextlib
import hashlib
import re
import secrets
import socket
import ssl
import subprocess
import threading
import time
from base64 import b64decode
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from scenes.free_port import free_port
from scenes.timed_picture import jpeg, scene, with_time

REALM = "camera"


@dataclass
class Behaviour:
    """What the camera does; a test changes it while it runs."""

    authentication: str = ""
    """`basic`, `digest`, `both`; empty: none."""
    user: str = "viewer"
    password: str = "tower-%7 secret"
    locks_after: int = 1000
    """Wrong passwords in a row after which it refuses the right one too."""
    clock_ahead: float = 0.0
    """Seconds."""
    tags: bool = False
    """Whether it knows ETags."""
    frozen: bool = False
    """The same bytes again."""
    status: int = 200
    location: str = ""
    stall_s: float = 0.0
    """Silent for so long before it answers,"""
    stall_within_s: float = 0.0
    """or after half of the body."""
    cut: bool = False
    """It ends the connection after half of the body,"""
    truncate: bool = False
    """or states the length of the half that it sends."""
    garbage: bytes = b""
    """Sent instead of a picture."""
    hang_up: bool = False
    """It closes the connection without an answer."""
    render: Callable[[float], bytes] = lambda moment: jpeg(with_time(scene(), moment))
    """The picture of a moment, seconds since the epoch."""
    frame_s: float = 0.1
    """Between two pictures of an MJPEG stream."""
    frames: int = 1_000_000
    """After which the stream ends."""


Route = Callable[["Request"], None]


@dataclass
class HttpCamera:
    """Runs from `with running(...)` on."""

    behaviour: Behaviour = field(default_factory=Behaviour)
    routes: dict[str, Route] = field(default_factory=dict)
    """By path. A route answers through the `Request` that it is given; who may ask is looked at before."""
    port: int = 0
    scheme: str = "http"
    asked: list[str] = field(default_factory=list)
    """Path and query of each request that passed."""
    refused: int = 0
    """Requests that a wrong password made."""
    _nonces: set[str] = field(default_factory=set)
    _picture: tuple[float, bytes] | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def url(self, path: str = "/snapshot.jpg") -> str:
        return f"{self.scheme}://127.0.0.1:{self.port}{path}"

    def picture(self) -> tuple[float, bytes]:
        """When the picture that the camera has now was taken, and its bytes."""
        behaviour = self.behaviour
        with self._lock:
            if self._picture is None or not behaviour.frozen:
                moment = time.time()
                self._picture = moment, behaviour.render(moment)
            return self._picture

    def allows(self, request: "Request") -> bool:
        """Whether user and password are right; answers with a challenge where they are not."""
        behaviour = self.behaviour
        if not behaviour.authentication:
            return True
        given = request.headers.get("authorization", "")
        right = self.refused < behaviour.locks_after and (
            self._basic(given) if given.startswith("Basic") else self._digest(given, request.command)
        )
        if right:
            self.refused = 0
            return True
        self.refused += bool(given)
        nonce = secrets.token_hex(8)
        self._nonces.add(nonce)
        offers = []
        if behaviour.authentication in ("digest", "both"):
            offers.append(f'Digest realm="{REALM}", nonce="{nonce}", qop="auth", algorithm=MD5')
        if behaviour.authentication in ("basic", "both"):
            offers.append(f'Basic realm="{REALM}"')
        request.answer(401, b"no", "text/plain", [("WWW-Authenticate", offer) for offer in offers])
        return False

    def _basic(self, given: str) -> bool:
        expected = f"{self.behaviour.user}:{self.behaviour.password}"
        offered = self.behaviour.authentication in ("basic", "both")
        return offered and b64decode(given.split()[1]).decode() == expected

    def _digest(self, given: str, method: str) -> bool:
        parts = {name: quoted or bare for name, quoted, bare in re.findall(r'(\w+)=(?:"([^"]*)"|([^\s,]+))', given)}
        if parts.get("nonce") not in self._nonces or self.behaviour.authentication == "basic":
            return False
        first = _md5(f"{self.behaviour.user}:{REALM}:{self.behaviour.password}")
        second = _md5(f"{method}:{parts['uri']}")
        expected = _md5(f"{first}:{parts['nonce']}:{parts['nc']}:{parts['cnonce']}:auth:{second}")
        return parts.get("username") == self.behaviour.user and parts.get("response") == expected


class Request(BaseHTTPRequestHandler):
    """One request to the camera."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    camera: HttpCamera
    body: bytes = b""

    def answer(self, status: int, body: bytes, kind: str, headers: list[tuple[str, str]] | None = None) -> None:
        """A whole answer, with the camera's own time."""
        self._begin(status, kind, [*(headers or []), ("Content-Length", str(len(body)))])
        self.wfile.write(body)

    def handle_one_request(self) -> None:
        with contextlib.suppress(ConnectionError, ssl.SSLError, ValueError):
            super().handle_one_request()
            return
        self.close_connection = True

    def do_GET(self) -> None:  # as http.server names it
        camera, behaviour = self.camera, self.camera.behaviour
        # Read before it is refused, or the rest would be taken for the next request.
        self.body = self.rfile.read(int(self.headers.get("content-length") or 0))
        if behaviour.hang_up:
            self.close_connection = True
            return
        if not camera.allows(self):
            return
        camera.asked.append(self.path)
        time.sleep(behaviour.stall_s)
        routes: dict[str, Route] = {"/snapshot.jpg": Request.snapshot, "/stream.mjpg": Request.mjpeg} | camera.routes
        route = routes.get(urlsplit(self.path).path)
        if route is None:
            self.answer(404, b"no such thing", "text/plain")
        else:
            route(self)

    do_POST = do_GET  # noqa: N815 # as http.server names it

    def snapshot(self) -> None:
        """The camera's picture, or what it does instead."""
        behaviour = self.camera.behaviour
        if behaviour.status != 200:
            where = [("Location", behaviour.location)] if behaviour.location else []
            self.answer(behaviour.status, b"no", "text/plain", where)
            return
        moment, body = self.camera.picture()
        tag, modified = f'"{_md5(str(moment))}"', formatdate(moment + behaviour.clock_ahead, usegmt=True)
        if behaviour.tags and self.headers.get("if-none-match") == tag:
            self.answer(304, b"", "image/jpeg")
            return
        headers = [("ETag", tag)] if behaviour.tags else []
        self._send(behaviour.garbage or body, [*headers, ("Last-Modified", modified)])

    def mjpeg(self) -> None:
        behaviour = self.camera.behaviour
        self._begin(200, "multipart/x-mixed-replace; boundary=frame", [("Connection", "close")])
        self.close_connection = True
        for _ in range(behaviour.frames):
            time.sleep(behaviour.stall_within_s or behaviour.frame_s)
            if behaviour.cut:
                return
            _, body = self.camera.picture()
            body = behaviour.garbage or body
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(body)}\r\n\r\n"
            self.wfile.write(head.encode() + body + b"\r\n")

    def date_time_string(self, timestamp: float | None = None) -> str:
        return formatdate(time.time() + self.camera.behaviour.clock_ahead, usegmt=True)

    def log_message(self, format: str, *args: Any) -> None:
        """Tests are told by what comes back."""

    def _send(self, body: bytes, headers: list[tuple[str, str]]) -> None:
        behaviour = self.camera.behaviour
        sent = body[: len(body) // 2] if behaviour.truncate else body
        self._begin(200, "image/jpeg", [*headers, ("Content-Length", str(len(sent)))])
        half = len(sent) // 2
        self.wfile.write(sent[:half])
        self.wfile.flush()
        if behaviour.stall_within_s:
            time.sleep(behaviour.stall_within_s)
        if behaviour.cut:
            self.close_connection = True
            self.connection.shutdown(socket.SHUT_RDWR)
            return
        self.wfile.write(sent[half:])

    def _begin(self, status: int, kind: str, headers: list[tuple[str, str]]) -> None:
        self.send_response_only(status)
        self.send_header("Date", self.date_time_string())
        for name, value in [("Content-Type", kind), *headers]:
            self.send_header(name, value)
        self.end_headers()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._connections: set[socket.socket] = set()

    def process_request(self, request: Any, client_address: Any) -> None:
        self._connections.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self._connections.discard(request)
        super().shutdown_request(request)

    def hang_up(self) -> None:
        """End all connections, as a camera without power does."""
        for connection in list(self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that is gone is none of the camera's concern."""


@contextlib.contextmanager
def running(camera: HttpCamera | None = None, certificate: tuple[str, str] | None = None) -> Iterator[HttpCamera]:
    """`certificate`: files of certificate and key, for https. A camera that had a port gets it again."""
    camera = camera or HttpCamera()
    handler = type("CameraRequest", (Request,), {"camera": camera})
    server = _Server(("127.0.0.1", camera.port or free_port()), handler)
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*certificate)
        server.socket = context.wrap_socket(server.socket, server_side=True)
        camera.scheme = "https"
    camera.port = server.server_address[1]
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield camera
    finally:
        server.shutdown()
        thread.join()
        server.hang_up()
        server.server_close()


def certificate(folder: Path, name: str) -> tuple[str, str]:
    """Files of a self-signed certificate for `name`, and of its key."""
    made = folder / f"{name}.pem", folder / f"{name}.key"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
         "-subj", "/CN=camera", "-addext", f"subjectAltName={name}", "-keyout", str(made[1]), "-out", str(made[0])],
        check=True, capture_output=True,
    )  # fmt: skip
    return str(made[0]), str(made[1])


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
