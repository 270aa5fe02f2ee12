"""Show a tower's live view on this machine: receive its stream, and serve the status page on loopback."""

import contextlib
import http.client
import json
import re
import socket
import subprocess  # nosec B404 # argument lists, no shell
import threading
import zlib
from collections.abc import Callable, Iterator
from http import HTTPStatus
from importlib.resources import files
from itertools import accumulate
from pathlib import Path
from typing import IO, Any, Final, Literal

from pydantic import BaseModel, Field, ValidationError

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.base.strict_model import problem_text
from ltm_ros.runtime.retry import Backoff
from ltm_ros.runtime.web_server import Route, WebResponse, WebServer
from ltm_ros.tower.health_client import TowerPort
from ltm_ros.tower.live_stream import FIRST_LINE, KINDS
from ltm_ros.viewer.server import wait_until_listening

LONGEST_LINE: Final = 1024
MOST_BYTES: Final = 2 << 20
"""Maximum bytes of a record, before and after decompression."""
MOST_CAMERAS: Final = 100
EVERY_MS: Final = 1000
"""Milliseconds between two requests of the page, which are local."""
HEALTH_PORT: Final = 9464
TUNNEL_S: Final = 60.0
"""Seconds for SSH to connect, with the time to enter a password."""


class StreamError(LtmError):
    """The tower sends what is not a stream of this version."""


class _Record(BaseModel):
    kind: Literal["page", "frame", "map"]
    bytes: int = Field(ge=0, le=MOST_BYTES)
    camera: str = Field("", pattern="^[a-z][a-z0-9_]{0,63}$|^$")
    stamp_s: float = Field(0.0, allow_inf_nan=False)
    sizes: list[int] = Field(default_factory=list, max_length=len(KINDS))


class TowerMirror:
    """Receives from a tower from construction until `close`, and connects again if the connection breaks.

    `reach`: returns the tower's port (`reached`). `url`: address of the page. Raises RejectedError if the tower rejects
    the token."""

    def __init__(self, reach: Callable[[], TowerPort], web_port: int = 0) -> None:
        self._reach = reach
        self._lock = threading.Lock()
        self._page: dict[str, Any] | None = None
        self._trouble = "connecting"
        self._stamps: dict[str, float] = {}
        """Stamps of the received frames in seconds, by camera."""
        self._closing = threading.Event()
        page = (files("ltm_ros.tower") / "status_page.html").read_bytes()
        self._routes: dict[str, Route] = {
            "GET /": _serving(page, "text/html; charset=utf-8"),
            "GET /page.json": lambda _: self._page_json(),
            "POST /mark": self._mark,
        }
        begun = self._reach().request("GET", "/live")
        self._server = WebServer(self._routes, port=web_port)
        self.url = self._server.url
        threading.Thread(target=self._receive, args=(begun,), name="tower", daemon=True).start()

    def close(self) -> None:
        """Stop serving; the connection ends with the next record."""
        self._closing.set()
        self._server.close()

    def stamps_s(self) -> dict[str, float]:
        """Return the stamps of the received frames in seconds, by camera."""
        with self._lock:
            return dict(self._stamps)

    def _receive(self, response: http.client.HTTPResponse | None) -> None:
        pace = Backoff(1.0)
        while not self._closing.is_set():
            try:
                with response or self._reach().request("GET", "/live") as stream:
                    response = None
                    for record, content in _records(stream):
                        if self._closing.is_set():
                            return
                        self._take(record, content)
                        pace.succeeded()
                why = "the tower closed the connection"
            except (LtmError, OSError, http.client.HTTPException) as error:
                why = str(error) or type(error).__name__
            with self._lock:
                self._trouble, self._page = f"{why}; connecting again", None
            self._closing.wait(pace.failed())

    def _take(self, record: _Record, content: bytes) -> None:
        if record.kind == "page":
            page = _json(content)
            with self._lock:
                self._page = page
        elif record.kind == "map":
            self._routes["GET /map.png"] = _serving(content, "image/png")
        else:
            ends = list(accumulate(record.sizes))
            if len(ends) != len(KINDS) or ends[-1] != len(content) or min(record.sizes) < 0 or not record.camera:
                raise StreamError(f"a frame has images of {record.sizes} bytes, and {len(content)} in all")
            if len(self._stamps) >= MOST_CAMERAS and record.camera not in self._stamps:
                raise StreamError(f"the tower sends images of more than {MOST_CAMERAS} cameras")
            images = [content[end - size : end] for size, end in zip(record.sizes, ends, strict=True)]
            for kind, image in zip((*KINDS, "full"), (*images, images[0]), strict=True):
                self._routes[f"GET /picture/{record.camera}/{kind}.jpg"] = _serving(image, "image/jpeg")
            with self._lock:
                self._stamps[record.camera] = record.stamp_s

    def _page_json(self) -> WebResponse:
        stamps = self.stamps_s()
        with self._lock:
            if self._page is None:
                return WebResponse.error(HTTPStatus.SERVICE_UNAVAILABLE, self._trouble)
            return WebResponse.json(self._page | {"pictures": stamps, "every_ms": EVERY_MS})

    def _mark(self, body: bytes) -> WebResponse:
        try:
            with self._reach().request("POST", "/mark", body) as response:
                return WebResponse(response.read(MOST_BYTES), "application/json")
        except LtmError as error:
            return WebResponse.error(HTTPStatus.BAD_GATEWAY, str(error))


def _serving(content: bytes, kind: str) -> Route:
    return lambda _: WebResponse(content, kind)


def _records(stream: IO[bytes] | http.client.HTTPResponse) -> Iterator[tuple[_Record, bytes]]:
    """Yield the records of a stream. Raises StreamError."""
    if stream.readline(LONGEST_LINE) != FIRST_LINE:
        raise StreamError("the tower's release sends another kind of stream: use the same release on both sides")
    while line := stream.readline(LONGEST_LINE):
        try:
            record = _Record.model_validate_json(line)
        except ValidationError as error:
            raise StreamError(f"the stream has an invalid record ({problem_text(error)})") from error
        content = stream.read(record.bytes)
        if len(content) < record.bytes:
            return
        yield record, content


def _json(content: bytes) -> dict[str, Any]:
    try:
        # `int` rejects the words for infinities and NaN, which are not JSON.
        found = json.loads(zlib.decompressobj().decompress(content, MOST_BYTES), parse_constant=int)
    except (zlib.error, ValueError, RecursionError) as error:
        raise StreamError("the stream has a page that is not JSON") from error
    if not isinstance(found, dict):
        raise StreamError("the stream has a page that is not a JSON mapping")
    return found


_DESTINATION = re.compile(r"(?P<host>[A-Za-z0-9_][A-Za-z0-9_.@-]*)(?::(?P<port>\d{1,5}))?")


@contextlib.contextmanager
def reached(tower: str, token: Path | None, certificate: Path | None) -> Iterator[Callable[[], TowerPort]]:
    """Yield a function that returns the tower's health port: of `https://HOST[:PORT]`, or by an SSH tunnel to
    `[USER@]HOST[:PORT]` that is opened again if it has ended, and closed afterwards. Raises ConfigError."""
    if "://" in tower:
        port = TowerPort.of_url(tower, token, certificate)
        yield lambda: port
        return
    match = _DESTINATION.fullmatch(tower)
    if match is None:
        raise ConfigError(f"--connect {tower}: give [USER@]HOST[:PORT] for SSH, or https://HOST[:PORT]")
    with socket.create_server(("127.0.0.1", 0)) as probe:
        here: int = probe.getsockname()[1]
    port = TowerPort.of_url(f"{'http' if certificate is None else 'https'}://127.0.0.1:{here}", token, certificate)
    forward = f"127.0.0.1:{here}:127.0.0.1:{match['port'] or HEALTH_PORT}"
    tunnel: subprocess.Popen[bytes] | None = None

    def reach() -> TowerPort:
        nonlocal tunnel
        if tunnel is None or tunnel.poll() is not None:
            tunnel = _ssh(match["host"], forward)
            try:
                wait_until_listening(here, tunnel, f"ssh {match['host']}", TUNNEL_S)
            except ConfigError as error:
                tunnel.kill()
                raise ConfigError(f"{error}; its messages are above") from error
        return port

    try:
        reach()
        yield reach
    finally:
        if tunnel is not None:
            tunnel.terminate()
            tunnel.wait()


def _ssh(host: str, forward: str) -> subprocess.Popen[bytes]:
    options = [f"-o{option}" for option in ("ExitOnForwardFailure=yes", "ServerAliveInterval=15")]
    try:
        return subprocess.Popen(["ssh", "-N", "-T", *options, "-L", forward, "--", host])  # nosec B603 B607
    except FileNotFoundError as error:
        raise ConfigError("--connect needs the program ssh: install openssh-client, or give https://HOST") from error
