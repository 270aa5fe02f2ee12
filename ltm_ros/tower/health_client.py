"""Serve a tower's health port, and query it."""

import http.client
import json
import ssl
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from ltm_core.base.errors import ConfigError
from ltm_core.site.sections import HealthConfig
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.ros_environment import secret
from ltm_ros.runtime.web_server import Route, WebServer, refusal

RETRY_S: Final = 5.0
"""Seconds between two attempts to open the port: shorter than diagnostics keep an error, so that they always show it.
"""
LEAST_TOKEN: Final = 16
"""Minimum length of a token in characters."""


def read_token(path: Path) -> str:
    """Return the token in a file. Raises ConfigError, whose message never repeats the file's content."""
    try:
        token = secret(path).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"health.token: {path}: cannot be read ({type(error).__name__})") from error
    if len(token) < LEAST_TOKEN or not token.isascii() or any(c.isspace() for c in token):
        raise ConfigError(
            f"health.token: {path}: give {LEAST_TOKEN} characters or more, such as `openssl rand -hex 32`"
        )
    return token


def open_health_server(config: HealthConfig, routes: Mapping[str, Route]) -> WebServer:
    """Open the server that the section `health` describes.

    Raises OSError if the address cannot be bound, ConfigError if the certificate, key or token cannot be read."""
    token, context = None if config.token is None else read_token(config.token), None
    if config.certificate is not None and config.key is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(secret(config.certificate), secret(config.key))
        except OSError as error:
            raise ConfigError(
                f"health: certificate {config.certificate} and key {config.key} cannot be used ({error})"
            ) from error
    return WebServer(routes, config.address, config.port, token=token, tls=context)


class PatientServer:
    """Serve from construction, or as soon as the port is free, and certificate, key and token can be read; until then
    `health` has the reason."""

    def __init__(
        self,
        config: HealthConfig,
        routes: Mapping[str, Route],
        health: Health,
        tell: Callable[[str], None],
        warn: Callable[[str], None],
        retry_s: float = RETRY_S,
    ) -> None:
        """Serve. `tell`: gets a line when it listens; `warn`: gets one at the first failure; both from any thread."""
        self._config, self._routes = config, routes
        self._health, self._tell, self._warn, self._retry_s = health, tell, warn, retry_s
        self._closing = threading.Event()
        self.server: WebServer | None = None
        """None while it does not listen."""
        self._thread = threading.Thread(target=self._try_again, name="health port", daemon=True)
        if (why := self._refusal()) is not None:
            self._warn(f"monitoring cannot reach this tower, everything else runs: {why}")
            self._thread.start()

    def close(self) -> None:
        self._closing.set()
        if self._thread.ident is not None:
            self._thread.join()
        if self.server is not None:
            self.server.close()

    def _refusal(self) -> str | None:
        """Open the server; return why that is not possible now."""
        try:
            self.server = open_health_server(self._config, self._routes)
        except (OSError, ConfigError) as error:
            place = self._config.address, self._config.port
            why = refusal(*place, error) if isinstance(error, OSError) else str(error)
            why += f"; retrying every {self._retry_s:g} s"
            self._health.trouble("port", why)
            return why
        self._tell(f"health port: {self.server.url}")
        return None

    def _try_again(self) -> None:
        while not self._closing.wait(self._retry_s) and self._refusal() is not None:
            pass


LARGEST = 16 << 20
TIMEOUT_S = 20.0
"""Longest wait for the next bytes of a tower."""


class RejectedError(ConfigError):
    """The tower does not accept the token."""


@dataclass(frozen=True)
class TowerPort:
    """A tower's health port. `tls`: None for plain HTTP, which is for loopback only."""

    host: str
    port: int
    tls: ssl.SSLContext | None = None
    token: str | None = None

    @classmethod
    def of_config(cls, config: HealthConfig) -> "TowerPort":
        """Return the port of a tower on this machine. Its certificate must be that of the site file. Raises
        ConfigError."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(config.address, config.address)  # nosec B104
        tls = None if config.certificate is None else _trusting(secret(config.certificate), check_name=False)
        return cls(host, config.port, tls, None if config.token is None else read_token(config.token))

    @classmethod
    def of_url(cls, url: str, token: Path | None, certificate: Path | None) -> "TowerPort":
        """Return the port of an address such as https://192.0.2.7:9464. `certificate`: that of the tower, or of its
        authority; None: the machine's authorities. Raises ConfigError."""
        try:
            parts = urlsplit(url)
            host, port = parts.hostname or "", parts.port or 9464
        except ValueError as error:
            raise ConfigError(f"{url}: not an address ({error}); give https://HOST[:PORT]") from error
        if parts.scheme == "http" and host not in ("127.0.0.1", "localhost", "::1"):
            raise ConfigError(f"{url}: would send the token unencrypted; give https://HOST[:PORT], or HOST for SSH")
        if parts.scheme not in ("http", "https") or not host or parts.path.strip("/") or parts.username:
            raise ConfigError(f"{url}: give https://HOST[:PORT]")
        tls = _trusting(certificate, check_name=certificate is None) if parts.scheme == "https" else None
        return cls(host, port, tls, None if token is None else read_token(token))

    def request(self, method: str, path: str, body: bytes | None = None) -> http.client.HTTPResponse:
        """Return the response of status 200, to be read and closed. Raises RejectedError or ConfigError."""
        place = f"{self.host}:{self.port}"
        headers = {"Host": f"[{self.host}]" if ":" in self.host else self.host, "Content-Type": "application/json"}
        if self.token is not None:
            headers["Authorization"] = f"Bearer {self.token}"
        connection: http.client.HTTPConnection
        if self.tls is None:
            connection = http.client.HTTPConnection(self.host, self.port, timeout=TIMEOUT_S)
        else:
            connection = http.client.HTTPSConnection(self.host, self.port, timeout=TIMEOUT_S, context=self.tls)
        try:
            connection.request(method, path, body, headers)
            answer = connection.getresponse()
            if answer.status == HTTPStatus.OK:
                return answer  # it keeps the socket
            said = answer.read(200).decode(errors="replace").strip()
        except (OSError, http.client.HTTPException, ValueError) as error:
            connection.close()
            raise ConfigError(
                f"{place}: no tower answers ({error}): check that `ltm run` of this site is running"
            ) from error
        connection.close()
        if answer.status == HTTPStatus.UNAUTHORIZED:
            raise RejectedError(f"{place}: the tower rejects the token (HTTP 401): give its token file")
        raise ConfigError(f"{place}: {answer.status} {said}")


def _trusting(certificate: Path | None, check_name: bool) -> ssl.SSLContext:
    """Return a context that accepts this certificate only, or those of the machine's authorities."""
    try:
        context = ssl.create_default_context(cafile=None if certificate is None else str(certificate))
    except OSError as error:
        raise ConfigError(f"{certificate}: not a certificate that can be read ({error})") from error
    context.check_hostname = check_name  # a given certificate identifies the tower under any address
    return context


def ask(config: HealthConfig, path: str) -> Any:
    """Return the JSON answer of a tower on this machine. Raises ConfigError."""
    port = TowerPort.of_config(config)
    with port.request("GET", path) as answer:
        try:
            return json.loads(answer.read(LARGEST))
        except (OSError, http.client.HTTPException, ValueError) as error:
            said = f"no tower answers, but another program ({error}); check the port"
            raise ConfigError(f"{port.host}:{port.port}: {said}") from error
