"""Send HTTP requests to a camera: authentication, certificates, limits of size and time; errors become SourceError
without secrets.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import ssl
import threading
import time
from collections.abc import Collection, Generator, Iterator, Mapping
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import httpx

from ltm_core.site.source_config import HttpSettings
from ltm_ros.cameras.protocols.credentials import Login, PictureError, SourceError, UnauthorisedError
from ltm_ros.cameras.protocols.picture import CameraTime

REFUSED = (401, 403, 423)
"""HTTP statuses with which a camera rejects the user, the password or the account."""
TAKEN = (200, 304)
WHOLE_FACTOR = 3
"""Maximum time of a whole answer, as a multiple of the limit for each part."""
KEEP_S = 75.0
"""Seconds for which a connection is kept, enough for one snapshot per minute."""


# They log each request's URL at INFO, which may contain a password.
for _name in ("httpx", "httpcore"):
    logging.getLogger(_name).setLevel(logging.WARNING)


@dataclass(frozen=True)
class HttpResponse:
    """`asked`, `arrived`: monotonic seconds of the request and of the answer's header."""

    status: int
    headers: Mapping[str, str]
    body: bytes
    asked: float
    arrived: float


class AutomaticAuth(httpx.Auth):
    """Digest authentication if the camera offers it, else basic; queries the offer once per connection, without a
    password.
    """

    def __init__(self, user: str, password: str) -> None:
        self._digest = httpx.DigestAuth(user, password)
        self._basic = httpx.BasicAuth(user, password)
        self._chosen: httpx.Auth | None = None

    def auth_flow(self, request: httpx.Request) -> Generator[httpx.Request, httpx.Response, None]:
        if self._chosen is None:
            response = yield request
            if response.status_code != 401:
                return
            offers = " ".join(response.headers.get_list("www-authenticate")).lower()
            self._chosen = self._digest if "digest" in offers else self._basic
        yield from self._chosen.auth_flow(request)


class HttpClient:
    """A connection to one camera, for one thread. Raises UnauthorisedError if the password cannot be read, SourceError
    if the certificates cannot.
    """

    def __init__(self, settings: HttpSettings, *, most_bytes: int) -> None:
        self._login = Login.of(settings)
        self._most_bytes = most_bytes
        self._whole_s = WHOLE_FACTOR * settings.timeout
        self._sockets: list[socket.socket] = []
        """Sockets of its newest connections."""
        self._late = threading.Event()
        self._client = httpx.Client(
            auth=self._auth(settings),
            verify=_certificates(settings),
            timeout=settings.timeout,
            # A redirect would send the password to another host.
            follow_redirects=False,
            trust_env=False,
            limits=httpx.Limits(max_connections=2, keepalive_expiry=KEEP_S),
            headers={"user-agent": "ltm"},
        )

    def close(self) -> None:
        self._client.close()

    def get(self, url: str, headers: Mapping[str, str] | None = None) -> HttpResponse:
        """Return the whole answer with status 200 or 304. Raises SourceError, UnauthorisedError, PictureError if it is
        too large.
        """
        return self.send("GET", url, headers)

    def send(
        self,
        method: str,
        url: str,
        headers: Mapping[str, str] | None = None,
        body: bytes | None = None,
        accepted: Collection[int] = TAKEN,
    ) -> HttpResponse:
        """Like `get`; `accepted`: statuses that are no errors."""
        with (
            self.within(self._whole_s),
            self.stream(url, headers, method, body, accepted) as (response, asked, arrived),
        ):
            whole = bytearray()
            for part in self.parts(response, asked + self._whole_s):
                whole += part
                if len(whole) > self._most_bytes:
                    raise PictureError(
                        f"answer of more than {self._most_bytes} bytes: configure smaller images in the camera, "
                        "or raise image_bytes under `limits:` in the site file"
                    )
            return HttpResponse(response.status_code, response.headers, bytes(whole), asked, arrived)

    @contextlib.contextmanager
    def stream(
        self,
        url: str,
        headers: Mapping[str, str] | None = None,
        method: str = "GET",
        body: bytes | None = None,
        accepted: Collection[int] = TAKEN,
    ) -> Iterator[tuple[httpx.Response, float, float]]:
        """Yield an answer whose body is still to come, with the times of the request and of its header. Raises as
        `get`.
        """
        with self._said(), contextlib.ExitStack() as stack:
            # Time of the last request after a challenge: its answer holds the image.
            asked = time.monotonic()

            def note(_: httpx.Request) -> None:
                nonlocal asked
                asked = time.monotonic()

            self._client.event_hooks = {"request": [note], "response": []}
            with self.within(self._whole_s):
                response = stack.enter_context(
                    self._client.stream(
                        method,
                        self._login.filled(url),
                        headers=dict(headers or {}),
                        content=body,
                        extensions={"trace": self._trace},
                    )
                )
            arrived = time.monotonic()
            self._check(response, accepted)
            yield response, asked, arrived

    def parts(self, response: httpx.Response, until: float) -> Iterator[bytes]:
        """Yield the body as it arrives. Raises SourceError after `until`."""
        for part in response.iter_bytes():
            yield part
            if time.monotonic() > until:
                raise SourceError(f"the camera took more than {self._whole_s:g} s for one image")

    @contextlib.contextmanager
    def within(self, seconds: float) -> Iterator[None]:
        """Raise SourceError in the body after the given seconds. A limit for each part is not enough: httpx waits for
        the end of a header that comes letter by letter, and the watchdog would end the process of all cameras.
        """
        late = threading.Event()

        def hang_up() -> None:
            late.set()
            self._late.set()
            for one in list(self._sockets):
                _hang_up(one)

        timer = threading.Timer(seconds, hang_up)
        timer.daemon = True
        timer.start()
        try:
            yield
        except (SourceError, httpx.HTTPError, httpx.StreamError, OSError) as error:
            if late.is_set() and not isinstance(error, UnauthorisedError):
                raise SourceError(f"the camera took more than {seconds:g} s for one image") from None
            raise
        finally:
            timer.cancel()
            if late.is_set():
                self._late.clear()

    def _trace(self, event: str, told: Mapping[str, Any]) -> None:
        """Record new connections of httpcore."""
        if event in ("connection.connect_tcp.complete", "connection.start_tls.complete"):
            made = told["return_value"].get_extra_info("socket")
            self._sockets = [*[one for one in self._sockets if one.fileno() >= 0][-2:], made]
            if self._late.is_set():
                _hang_up(made)

    def _auth(self, settings: HttpSettings) -> httpx.Auth | None:
        if settings.user is None or "{password}" in settings.url:
            return None
        password = self._login.password.reveal() if self._login.password is not None else ""
        kinds: dict[str, Any] = {"basic": httpx.BasicAuth, "digest": httpx.DigestAuth, "auto": AutomaticAuth}
        made: httpx.Auth = kinds[settings.authentication](settings.user, password)
        return made

    def _check(self, response: httpx.Response, accepted: Collection[int]) -> None:
        status = response.status_code
        if status in accepted:
            return
        if status in REFUSED:
            who = f"user {self._login.user}" if self._login.user else "a request without user and password"
            raise UnauthorisedError(f"the camera rejected {who} (HTTP {status}). Check the user name and password")
        if 300 <= status < 400:
            place = self._login.redact(response.headers.get("location", "elsewhere"))
            raise SourceError(f"the camera redirects to {place} (HTTP {status}): set this address as url")
        raise SourceError(f"the camera answered HTTP {status} {response.reason_phrase}".rstrip())

    @contextlib.contextmanager
    def _said(self) -> Iterator[None]:
        """Return an httpx error as SourceError without secrets."""
        try:
            yield
        except httpx.TimeoutException as error:
            what = "the connection" if isinstance(error, httpx.ConnectTimeout) else "an answer"
            raise SourceError(
                f"the camera does not respond: no {what.removeprefix('the ').removeprefix('an ')} in time"
            ) from None
        except httpx.ConnectError as error:
            raise SourceError(f"no connection: {self._login.redact(error)}") from None
        except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError, OSError, ValueError) as error:
            kind = type(error).__name__
            raise SourceError(
                f"the camera closed the connection or did not answer HTTP ({kind}): {self._login.redact(error)}"
            ) from None


def _hang_up(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


def http_time(headers: Mapping[str, str], name: str) -> CameraTime | None:
    """Return a time from a header; None if missing or invalid. Whole seconds, as in RFC 9110."""
    try:
        return CameraTime(parsedate_to_datetime(headers[name]).timestamp(), 1.0, name.lower())
    except (KeyError, TypeError, ValueError, OverflowError):
        return None


def _certificates(settings: HttpSettings) -> ssl.SSLContext:
    """Return one SSL context for all connections with the same certificates, because reading the system's takes longer
    than connecting.
    """
    try:
        changed = None if settings.ca is None else settings.ca.stat().st_mtime_ns
        return _context(settings.ca, changed, settings.check_name)
    except (OSError, ssl.SSLError) as error:
        raise SourceError(f"ca {settings.ca} cannot be read: {error.strerror or error}") from None


@lru_cache(maxsize=64)
def _context(ca: Path | None, changed: int | None, check_name: bool) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=None if ca is None else str(ca))
    context.check_hostname = check_name
    return context
