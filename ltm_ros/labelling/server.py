"""Serves the labelling page and its requests, to this machine and to whoever has the link, and to nobody else."""

from __future__ import annotations

import json
import secrets
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, cast

from ltm_core.base.errors import LtmError
from ltm_ros.labelling.session import LabelSession

LOOPBACK = "127.0.0.1"
MOST_BYTES = 8 << 20
"""Of a request."""
PATIENCE_S = 20.0
"""For a request to come whole."""


class LabelServer(ThreadingHTTPServer):
    """On the loopback interface; its address holds a token that nobody can guess. `port`: 0 takes a free one."""

    daemon_threads = True

    def __init__(self, session: LabelSession, port: int = 0) -> None:
        self.session = session
        self.token = secrets.token_urlsafe(24)
        super().__init__((LOOPBACK, port), _Handler)

    @property
    def url(self) -> str:
        return f"http://{LOOPBACK}:{self.server_port}/{self.token}/"

    @property
    def hosts(self) -> tuple[str, str]:
        """Names under which a browser may ask: another one has been led here by a name that was bent to this place."""
        return f"{LOOPBACK}:{self.server_port}", f"localhost:{self.server_port}"


class _Handler(BaseHTTPRequestHandler):
    server_version, sys_version = "ltm", ""
    protocol_version = "HTTP/1.1"
    timeout = PATIENCE_S

    def do_GET(self) -> None:
        parts = self._parts()
        session = self._server.session
        if parts is None:
            self._refuse(404, "no such page")
        elif parts == [""]:
            self._page()
        elif parts == ["photos"]:
            self._answer(lambda: session.overview())
        elif len(parts) == 2 and parts[0] in ("photo", "areas", "suggested") and _is_number(parts[1]):
            number = int(parts[1])
            if parts[0] == "photo":
                self._photo(number)
            else:
                self._answer(lambda: session.areas(number) if parts[0] == "areas" else session.suggested(number))
        else:
            self._refuse(404, "no such page")

    def do_PUT(self) -> None:
        parts = self._parts()
        origin = self.headers.get("Origin")
        if parts is None or len(parts) != 2 or parts[0] != "areas" or not _is_number(parts[1]):
            self._refuse(404, "no such page")
        elif origin is not None and origin not in {f"http://{host}" for host in self._server.hosts}:
            self._refuse(403, "from another page")
        else:
            content = self._content()
            if content is not None:
                self._answer(lambda: self._server.session.save(int(parts[1]), content))

    @property
    def _server(self) -> LabelServer:
        return cast("LabelServer", self.server)

    def _parts(self) -> list[str] | None:
        """What follows the token; None for an address that is not of this server's page."""
        head, _, rest = self.path.removeprefix("/").partition("/")
        known = secrets.compare_digest(head.encode(), self._server.token.encode())
        if not known or "/" not in self.path[1:] or self.headers.get("Host") not in self._server.hosts:
            return None
        return rest.split("/")

    def _content(self) -> object | None:
        """The JSON of a request; None where it was refused."""
        length = self.headers.get("Content-Length", "")
        if not _is_number(length) or self.headers.get("Transfer-Encoding"):
            self._refuse(411, "say how long the request is")
            return None
        if int(length) > MOST_BYTES:
            self._refuse(413, f"at most {MOST_BYTES} bytes are taken")
            return None
        try:
            return cast("object", json.loads(self.rfile.read(int(length))))
        except (ValueError, RecursionError) as error:
            self._refuse(400, f"not JSON ({error})")
            return None

    def _answer(self, make: Any) -> None:
        try:
            content = make()
        except LtmError as error:
            self._refuse(400, str(error))
        except OSError as error:
            self._refuse(507, f"cannot be written: {error.strerror}")
        else:
            self._send(200, "application/json", json.dumps(content).encode())

    def _photo(self, number: int) -> None:
        try:
            photo = self._server.session.photo(number)
        except LtmError as error:
            self._refuse(400, str(error))
        else:
            self._send(200, "image/jpeg", photo)

    def _page(self) -> None:
        nonce = secrets.token_urlsafe(16)
        page = files("ltm_ros.labelling").joinpath("page.html").read_text("utf-8").replace("NONCE", nonce)
        rules = (
            f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src 'self' data:; "
            "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
        self._send(200, "text/html; charset=utf-8", page.encode(), {"Content-Security-Policy": rules})

    def _refuse(self, status: int, why: str) -> None:
        # What is left of a request that was not read must not be taken for the next one.
        self.close_connection = True
        self._send(status, "application/json", json.dumps({"error": why}).encode(), {"Connection": "close"})

    def _send(self, status: int, kind: str, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        always = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
        }
        for name, value in (always | (headers or {})).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: a person looks at the page, not at its requests."""


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 10
