"""Answer HTTP requests, on loopback unless the site file says otherwise; check TCP ports."""

import base64
import contextlib
import errno
import hmac
import ipaddress
import json
import socket
import ssl
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit


def bind_error(address: str, port: int) -> OSError | None:
    """Return why a port cannot be opened now; None: it can."""
    with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((address, port))
        except OSError as error:
            return error
    return None


def refusal(address: str, port: int, error: OSError) -> str:
    """Return why the health port cannot be opened, and what to do."""
    remedy = {
        errno.EADDRINUSE: f"end the program that uses it (`ss -ltnp 'sport = :{port}'` names it), or choose another",
        errno.EADDRNOTAVAIL: "this machine has no such address now: check the network, or choose an existing address",
        errno.EACCES: "ports below 1024 need privileges that a service lacks: choose a higher one",
    }.get(error.errno or 0, "choose another")
    return f"{address}:{port} cannot be opened ({error.strerror}): {remedy} in `health: {{port: ..., address: ...}}`"


TIMEOUT_S = 10.0
"""Longest wait for the next bytes of a request, and for the client to read the next bytes of a response."""
REQUEST_S = 30.0
"""Default time limit of a whole request, so that a slow client cannot hold a connection for ever."""
CONNECTIONS = 16
"""Maximum number of open connections; further ones are closed at once."""
STREAM_BUFFER = 64 << 10
"""Bytes of a stream that wait in the kernel for a slow client; more would make its content old."""
BODY_BYTES = 4096
"""Default size limit of a request's body."""
POLICY = "default-src 'self' 'unsafe-inline'; frame-ancestors 'none'"
"""Default Content-Security-Policy of a response."""


@dataclass(frozen=True)
class WebResponse:
    """What a handler returns: the body, its content type, the status and the page's Content-Security-Policy. `stream`:
    what to send instead of a body, until the client leaves, however long that takes."""

    body: bytes
    kind: str = "text/plain; charset=utf-8"
    status: HTTPStatus = HTTPStatus.OK
    policy: str = POLICY
    stream: Iterator[bytes] | None = None

    @classmethod
    def json(cls, value: object) -> "WebResponse":
        return cls(json.dumps(value, allow_nan=False, default=str).encode(), "application/json")

    @classmethod
    def error(cls, status: HTTPStatus, why: str) -> "WebResponse":
        return cls(f"{why}\n".encode(), status=status)


Route = Callable[[bytes], WebResponse]
"""Handles a request, given its body (empty for GET). It is called from a thread of the server."""


class WebServer:
    """Serve requests from its own threads, from construction until `close`. Raises OSError if it cannot bind.

    A server on a loopback address without a token answers only requests that name it `localhost` or by its address, so
    that a foreign page in a browser on the same machine cannot read it through a name of its own.

    Args: routes: handlers by method and path, as "GET /status.json"; a query string is ignored. port: 0 takes a free
    one. token: what a client must send as bearer token or as password. tls: serves HTTPS. body_bytes: size limit of a
    request's body. request_s: time limit of a request, seconds."""

    def __init__(
        self,
        routes: Mapping[str, Route],
        address: str = "127.0.0.1",
        port: int = 0,
        *,
        token: str | None = None,
        tls: ssl.SSLContext | None = None,
        body_bytes: int = BODY_BYTES,
        request_s: float = REQUEST_S,
    ) -> None:
        ip = ipaddress.ip_address(address)
        hosts = {"localhost", str(ip)} if ip.is_loopback and token is None else None
        self._server = _BoundedServer((address, port), _handler(routes, token, hosts, body_bytes), tls, request_s)
        self.port: int = self._server.server_address[1]
        host = f"[{address}]" if ip.version == 6 else address
        self.url = f"{'http' if tls is None else 'https'}://{host}:{self.port}"
        threading.Thread(target=self._server.serve_forever, name="web server", daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


class _BoundedServer(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = CONNECTIONS

    def __init__(
        self,
        address: tuple[str, int],
        handler: type[BaseHTTPRequestHandler],
        tls: ssl.SSLContext | None,
        request_s: float,
    ) -> None:
        self.address_family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._room = threading.BoundedSemaphore(CONNECTIONS)
        self._tls, self._request_s = tls, request_s
        self._ends: dict[Any, threading.Timer] = {}
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._room.acquire(blocking=False):
            self.shutdown_request(request)
            return
        request.settimeout(TIMEOUT_S)
        try:
            super().process_request(request, client_address)
        except BaseException:
            self._room.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        end = None
        try:
            if self._tls is not None:
                request = self._tls.wrap_socket(request, server_side=True, do_handshake_on_connect=False)
            end = self._ends[request] = threading.Timer(self._request_s, _hang_up, (request,))
            end.start()
            if self._tls is not None:
                # The handshake runs here and not in `accept`, so that a slow client does not block the others.
                request.do_handshake()
            super().process_request_thread(request, client_address)
        except OSError:
            self.shutdown_request(request)
        finally:
            if end is not None:
                end.cancel()
                self._ends.pop(request, None)
            self._room.release()

    def keep(self, request: Any) -> None:
        """Let a request last, with a small buffer."""
        self._ends[request].cancel()
        request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, STREAM_BUFFER)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log nothing if a client disconnects or sends junk."""


def _hang_up(request: socket.socket) -> None:
    with contextlib.suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


def _handler(
    routes: Mapping[str, Route], token: str | None, hosts: set[str] | None, body_bytes: int
) -> type[BaseHTTPRequestHandler]:
    class RequestHandler(BaseHTTPRequestHandler):
        server_version, sys_version = "ltm", ""
        protocol_version = "HTTP/1.0"
        timeout = TIMEOUT_S
        server: _BoundedServer

        def do_GET(self) -> None:
            self._respond()

        do_HEAD = do_POST = do_PUT = do_GET  # noqa: N815 # as http.server names them

        def log_message(self, *_: object) -> None:
            """Log no requests: monitoring systems send one every few seconds."""

        def _respond(self) -> None:
            response = self._response()
            self.send_response(response.status)
            self.send_header("Content-Type", response.kind)
            if response.stream is None:
                self.send_header("Content-Length", str(len(response.body)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Referrer-Policy", "no-referrer")
            self.send_header("Cross-Origin-Resource-Policy", "same-origin")
            self.send_header("Content-Security-Policy", response.policy)
            if response.status is HTTPStatus.UNAUTHORIZED:
                self.send_header("WWW-Authenticate", 'Basic realm="ltm", charset="UTF-8"')
            self.end_headers()
            if response.stream is not None and self.command == "GET":
                self.server.keep(self.request)
                for part in _guarded(response.stream):
                    self.wfile.write(part)
            elif self.command != "HEAD":
                self.wfile.write(response.body)

        def _response(self) -> WebResponse:
            host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
            if hosts is not None and _host(host) not in hosts:
                return WebResponse.error(HTTPStatus.MISDIRECTED_REQUEST, "use this machine's address")
            if hosts is not None and origin is not None and origin.partition("://")[2] != host:
                return WebResponse.error(HTTPStatus.FORBIDDEN, "the request comes from another page")
            if token is not None and not _knows(self.headers.get("Authorization", ""), token):
                return WebResponse.error(HTTPStatus.UNAUTHORIZED, "a token is needed")
            sends = self.command in ("POST", "PUT")
            route = routes.get(f"{self.command if sends else 'GET'} {urlsplit(self.path).path}")
            if route is None:
                return WebResponse.error(HTTPStatus.NOT_FOUND, "not found")
            return self._with_body(route) if sends else _handled(route, b"")

        def _with_body(self, route: Route) -> WebResponse:
            # A foreign page can make a browser that knows the token send forms, but not JSON.
            if self.headers.get_content_type() != "application/json":
                return WebResponse.error(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "send application/json")
            length = self.headers.get("Content-Length", "")
            if not (length.isascii() and length.isdigit()) or self.headers.get("Transfer-Encoding"):
                return WebResponse.error(HTTPStatus.LENGTH_REQUIRED, "give Content-Length")
            if len(length) > 15 or int(length) > body_bytes:
                why = f"the body is too large; send at most {body_bytes} bytes"
                return WebResponse.error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, why)
            return _handled(route, self.rfile.read(int(length)))

    return RequestHandler


def _handled(route: Route, body: bytes) -> WebResponse:
    """Return the handler's response, or status 500 if it raises; the traceback then goes to the log."""
    try:
        return route(body)
    except Exception:
        sys.excepthook(*sys.exc_info())
        return WebResponse.error(HTTPStatus.INTERNAL_SERVER_ERROR, "internal error: see the log")


def _guarded(stream: Iterator[bytes]) -> Iterator[bytes]:
    """Yield a stream; it ends with a traceback in the log if it raises."""
    try:
        yield from stream
    except Exception:
        sys.excepthook(*sys.exc_info())


def _host(header: str) -> str:
    """Return the name or address in a Host header in lower case, without port and brackets; "" if it is invalid."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def _knows(authorization: str, token: str) -> bool:
    """Return whether a header holds `Bearer TOKEN`, or the token as the password of any user, as browsers send it."""
    scheme, _, given = authorization.partition(" ")
    if scheme.lower() == "basic":
        try:
            given = base64.b64decode(given, validate=True).decode("ascii").partition(":")[2]
        except ValueError:
            return False
    elif scheme.lower() != "bearer":
        return False
    return hmac.compare_digest(given.strip().encode(errors="replace"), token.encode())
