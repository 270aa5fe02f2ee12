"""A server of health that somebody else's hold of its port does not keep from running later."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Final

from ltm_core.site.sections import HealthConfig
from ltm_ros.runtime.health import Health
from ltm_ros.tower.web_server import PortError, Route, Taking, WebServer

RETRY_S: Final = 5.0
"""Until a port is tried again: shorter than diagnostics say what is wrong, so that they say it all the time."""


class PatientServer:
    """Serves from the moment it is made, or as soon as its port is free; until then `health` says what is wrong.

    What answers monitoring systems shall not keep a tower from its work. Raises ConfigError where a certificate or the
    token cannot be read: time mends neither.
    """

    def __init__(
        self,
        config: HealthConfig,
        routes: Mapping[str, Route],
        taking: Mapping[str, Taking],
        health: Health,
        tell: Callable[[str], None],
        warn: Callable[[str], None],
        retry_s: float = RETRY_S,
    ) -> None:
        """`tell`: a line when it listens; `warn`: when it cannot, the first time; from any thread."""
        self._config, self._routes, self._taking = config, routes, taking
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
        """None while it does not listen."""
        return None if self._server is None else self._server.url

    def close(self) -> None:
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
        if self._server is not None:
            self._server.close()

    def _listen(self) -> bool:
        try:
            self._server = WebServer(self._config, self._routes, self._taking)
        except PortError as error:
            said = f"{error}; it is tried again every {self._retry_s:g} s"
            self._health.trouble("port", said)
            if not self._refused:
                self._warn(f"no answers to monitoring systems, all else runs: {said}")
            self._refused = True
            return False
        self._tell(f"health at {self._server.url}")
        return True

    def _try_again(self) -> None:
        while not self._closing.wait(self._retry_s):
            if self._listen():
                return
