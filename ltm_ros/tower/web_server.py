"""Answers monitoring systems and browsers by HTTP: on loopback, or elsewhere by TLS to whoever knows a token."""

from __future__ import annotations

import base64
import contextlib
import hmac
import ipaddress
import json
import socket
import ssl
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from ltm_core.base.errors import ConfigError
from ltm_core.site.sections import HealthConfig
from ltm_ros.runtime.ports import refusal
from ltm_ros.runtime.service_credentials import service_credential

TIMEOUT_S = 10.0
"""For each part of a request to come and of an answer to be taken: who is slower is let go,"""
WHOLE_S = 30.0
"""and who has not had all of it by then, however steadily it drips: there are few places."""
CONNECTIONS = 16
"""At a time; others are closed at once."""
LEAST_TOKEN = 16
"""Characters."""
LONGEST_BODY = 4096
"""Bytes, of what is sent here."""


@dataclass(frozen=True)
class Answer:
    body: bytes
    kind: str = "text/plain; charset=utf-8"
    status: HTTPStatus = HTTPStatus.OK

    @classmethod
    def json(cls, value: object) -> Answer:
        return cls(json.dumps(value, allow_nan=False, default=str).encode(), "application/json")


Route = Callable[[], Answer]
Taking = Callable[[bytes], Answer]
"""Answers what was sent."""


def secret(path: Path) -> Path:
    """A file with a secret: the systemd credential of its name where the service was given one, else `path`."""
    return service_credential(path.name) or path


def read_token(path: Path) -> str:
    """Raises ConfigError; what is in the file is in no message."""
    try:
        token = secret(path).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"health.token: {path}: cannot be read ({type(error).__name__})") from error
    if len(token) < LEAST_TOKEN or not token.isascii() or any(c.isspace() for c in token):
        raise ConfigError(
            f"health.token: {path}: give {LEAST_TOKEN} characters or more, such as `openssl rand -hex 32`"
        )
    return token


class PortError(ConfigError):
    """A port cannot be listened on now; later it may be."""


class WebServer:
    """Serves `routes` (by path) from threads of its own, from the moment it is made; `taking`: where JSON may be sent.

    Raises PortError where the address is taken, ConfigError where a certificate or the token cannot be read.
    """

    def __init__(
        self, config: HealthConfig, routes: Mapping[str, Route], taking: Mapping[str, Taking] | None = None
    ) -> None:
        self._token = read_token(config.token) if config.token is not None else None
        address = ipaddress.ip_address(config.address)
        # A page of somebody else in a browser on this machine could have its own name lead here.
        hosts = {"localhost", str(address)} if address.is_loopback and self._token is None else None
        handler = _handler(routes, taking or {}, self._token, hosts)
        try:
            self._server = _BoundedServer((config.address, config.port), handler, config)
        except OSError as error:
            raise PortError(refusal(config.address, config.port, error)) from error
        scheme = "https" if config.certificate else "http"
        host = f"[{config.address}]" if ":" in config.address else config.address
        self.url = f"{scheme}://{host}:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="health web", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


class _BoundedServer(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = CONNECTIONS

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler], config: HealthConfig) -> None:
        self.address_family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._room = threading.BoundedSemaphore(CONNECTIONS)
        self._tls = _tls(config)
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
            end = threading.Timer(WHOLE_S, _hang_up, (request,))
            end.start()
            if self._tls is not None:
                # Here, not where connections are accepted: a client that is slow with it holds up nobody.
                request.do_handshake()
            super().process_request_thread(request, client_address)
        except OSError:
            self.shutdown_request(request)
        finally:
            if end is not None:
                end.cancel()
            self._room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that goes away, or sends junk, is nothing to write of."""


def _hang_up(request: socket.socket) -> None:
    with contextlib.suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


def _tls(config: HealthConfig) -> ssl.SSLContext | None:
    if config.certificate is None or config.key is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(secret(config.certificate), secret(config.key))
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(
            f"health: certificate {config.certificate} and key {config.key} cannot be taken ({error})"
        ) from error
    return context


def _handler(
    routes: Mapping[str, Route], taking: Mapping[str, Taking], token: str | None, hosts: set[str] | None
) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        server_version, sys_version = "ltm", ""
        protocol_version = "HTTP/1.0"
        timeout = TIMEOUT_S

        def do_GET(self) -> None:
            self._answer()

        def do_HEAD(self) -> None:
            self._answer()

        def do_POST(self) -> None:
            self._answer()

        def log_message(self, *_: object) -> None:
            """Scrapes come each few seconds."""

        def _answer(self) -> None:
            if hosts is not None and _host(self.headers.get("Host", "")) not in hosts:
                answer = Answer(b"ask for this machine by its address\n", status=HTTPStatus.MISDIRECTED_REQUEST)
            elif token is not None and not _knows(self.headers.get("Authorization", ""), token):
                answer = Answer(b"a token is needed\n", status=HTTPStatus.UNAUTHORIZED)
            else:
                answer = self._asked()
            self.send_response(answer.status)
            self.send_header("Content-Type", answer.kind)
            self.send_header("Content-Length", str(len(answer.body)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Content-Security-Policy", "default-src 'self' 'unsafe-inline'; frame-ancestors 'none'")
            if answer.status is HTTPStatus.UNAUTHORIZED:
                self.send_header("WWW-Authenticate", 'Basic realm="ltm", charset="UTF-8"')
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(answer.body)

        def _asked(self) -> Answer:
            if self.command == "POST":
                return self._taken()
            route = routes.get(urlsplit(self.path).path)
            return Answer(b"not found\n", status=HTTPStatus.NOT_FOUND) if route is None else _made(route)

        def _taken(self) -> Answer:
            take = taking.get(urlsplit(self.path).path)
            if take is None:
                return Answer(b"not found\n", status=HTTPStatus.NOT_FOUND)
            # A page of somebody else may send forms from a browser that knows the token, but no JSON without asking.
            if self.headers.get_content_type() != "application/json":
                return Answer(b"send application/json\n", status=HTTPStatus.UNSUPPORTED_MEDIA_TYPE)
            length = self.headers.get("Content-Length", "")
            if not length.isascii() or not length.isdigit() or int(length) > LONGEST_BODY:
                return Answer(b"say how long it is, at most 4096 bytes\n", status=HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
            body = self.rfile.read(int(length))
            return _made(lambda: take(body))

    return Handler


def _made(answer: Route) -> Answer:
    """Where a bug, or the machine, prevents an answer, that is one: `handle_error` says nothing, and a person at night
    shall not look at an empty page."""
    try:
        return answer()
    except Exception:
        sys.excepthook(*sys.exc_info())
        return Answer(b"it failed: see the log\n", status=HTTPStatus.INTERNAL_SERVER_ERROR)


def _host(header: str) -> str:
    """Name or address in a header `Host`, in lower case, without port and brackets; empty where it is none."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def _knows(authorization: str, token: str) -> bool:
    """`Bearer TOKEN`, or the token as a password under any name: a browser asks for these."""
    scheme, _, given = authorization.partition(" ")
    if scheme.lower() == "basic":
        try:
            given = base64.b64decode(given, validate=True).decode("ascii").partition(":")[2]
        except ValueError:
            return False
    elif scheme.lower() != "bearer":
        return False
    return hmac.compare_digest(given.strip().encode(errors="replace"), token.encode())
