"""Serves a tower's status; while its port is in use, it waits for it and the tower works on."""

from __future__ import annotations

import ssl
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

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


class PortError(ConfigError):
    """The port cannot be opened now; a later attempt may work."""


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

    Raises PortError if the address cannot be bound, ConfigError if the certificate, key or token cannot be read.
    """
    token = None if config.token is None else read_token(config.token)
    try:
        return WebServer(routes, config.address, config.port, token=token, tls=_tls(config))
    except OSError as error:
        raise PortError(refusal(config.address, config.port, error)) from error


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


class PatientServer:
    """Serve from construction, or as soon as the port is free; until then `health` has the reason.

    Raises ConfigError if the certificate, key or token cannot be read: waiting does not help there.
    """

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
        self._server: WebServer | None = None
        self._refused = False
        self._thread: threading.Thread | None = None
        if not self._listen():
            self._thread = threading.Thread(target=self._try_again, name="health port", daemon=True)
            self._thread.start()

    @property
    def url(self) -> str | None:
        """Return the URL; None while it does not listen."""
        return None if self._server is None else self._server.url

    def close(self) -> None:
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
        if self._server is not None:
            self._server.close()

    def _listen(self) -> bool:
        try:
            self._server = open_health_server(self._config, self._routes)
        except PortError as error:
            said = f"{error}; retrying every {self._retry_s:g} s"
            self._health.trouble("port", said)
            if not self._refused:
                self._warn(f"monitoring cannot reach this tower, everything else runs: {said}")
            self._refused = True
            return False
        self._tell(f"health port: {self._server.url}")
        return True

    def _try_again(self) -> None:
        while not self._closing.wait(self._retry_s):
            if self._listen():
                return
