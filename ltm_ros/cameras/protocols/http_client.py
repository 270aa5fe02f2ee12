"""Send HTTP requests to a camera: authentication, certificates, limits of size and time; errors become SourceError
without secrets."""

import contextlib
import logging
import re
import ssl
import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from functools import lru_cache
from pathlib import Path

import httpx

from ltm_core.base.redaction import plain, redacted
from ltm_core.site.source_config import HttpSettings
from ltm_ros.cameras.protocols.credentials import Login, PictureError, SourceError
from ltm_ros.cameras.protocols.http_wire import CameraAuth, CameraNetwork, CameraTransport
from ltm_ros.cameras.protocols.picture import CameraTime, Timing

REFUSED = (401, 403, 423)
"""HTTP statuses with which a camera rejects the user, the password or the account."""
TAKEN = (200, 304)
WHOLE_FACTOR = 3
"""Maximum time of a whole answer, as a multiple of the limit for each part."""
KEEP_S = 75.0
"""Seconds for which a connection is kept, enough for one snapshot per minute."""

Headers = Mapping[str, str]

# They log each request's URL at INFO, which may contain a password.
for _name in ("httpx", "httpcore"):
    logging.getLogger(_name).setLevel(logging.WARNING)


@dataclass(frozen=True)
class HttpResponse:
    """`asked`, `arrived`: monotonic seconds of the request and of the answer's header."""

    status: int
    headers: Headers
    body: bytes
    asked: float
    arrived: float

    def timing(self, oldest: float, taken: CameraTime | None) -> Timing:
        """Return the timing of an image in the answer. `oldest`: its maximum age at the request, seconds."""
        return Timing(self.arrived, self.asked, oldest, taken, answered=http_time(self.headers, "Date"))


class HttpClient:
    """A connection to one camera, for one thread. An address without host is one of `settings.url`.

    Raises UnauthorisedError if the password cannot be read, SourceError if the certificates cannot."""

    def __init__(self, settings: HttpSettings, *, most_bytes: int) -> None:
        self.login, self.url = Login.of(settings), settings.url
        self._most_bytes = most_bytes
        self._whole_s = WHOLE_FACTOR * settings.timeout
        self._network = CameraNetwork()
        auth = None
        if settings.user is not None and "{password}" not in settings.url:
            kind = settings.authentication
            auth = CameraAuth(settings.user, self.login.secret, ("digest", "basic") if kind == "auto" else (kind,))
        self._client = httpx.Client(
            auth=auth,
            transport=CameraTransport(_certificates(settings), KEEP_S, self._network),
            timeout=settings.timeout,
            # A redirect would send the password to another host.
            follow_redirects=False,
            trust_env=False,
            headers={"user-agent": "ltm"},
        )

    def close(self) -> None:
        self._client.close()

    def get(
        self, url: str, headers: Headers | None = None, post: bytes | None = None, accepted: Collection[int] = TAKEN
    ) -> HttpResponse:
        """Return the whole answer to a GET, or to a POST of `post`. `accepted`: statuses that are no errors. Raises
        SourceError, UnauthorisedError, PictureError if it is too large."""
        with self.stream(url, headers, post, accepted) as (response, asked, arrived):
            if response.headers.get("content-type", "").lower().startswith("multipart/x-mixed-replace"):
                raise SourceError("the camera answered with a stream of images: set kind: mjpeg")
            whole = bytearray()
            try:
                for part in response.iter_bytes():
                    whole += part
                    if len(whole) > self._most_bytes:
                        raise PictureError(
                            f"answer of more than {self._most_bytes} bytes: configure smaller images in the camera, "
                            "or raise image_bytes under `expert.limits` in the site file"
                        )
            except (httpx.ReadTimeout, httpx.RemoteProtocolError):
                # The stated length is too large, or the last chunk is missing; a whole JPEG is accepted.
                if not is_whole_jpeg(whole):
                    raise
            return HttpResponse(response.status_code, response.headers, bytes(whole), asked, arrived)

    @contextlib.contextmanager
    def stream(
        self, url: str, headers: Headers | None = None, post: bytes | None = None, accepted: Collection[int] = TAKEN
    ) -> Iterator[tuple[httpx.Response, float, float]]:
        """Yield an answer whose body is still to come, with the times of the request and of its header. Raises as
        `get`."""
        url = self.login.filled(url if "://" in url else self.url + url)
        asked = [time.monotonic()]
        # The time of the last request after a challenge counts: its answer holds the image.
        self._client.event_hooks = {"request": [lambda _: asked.append(time.monotonic())], "response": []}
        with self.in_time():
            method = "GET" if post is None else "POST"
            with self._client.stream(method, url, headers=dict(headers or {}), content=post) as response:
                arrived = time.monotonic()
                self._check(response, accepted)
                yield response, asked[-1], arrived

    @contextlib.contextmanager
    def in_time(self) -> Iterator[None]:
        """Limit the body to the time of a whole answer. Raises SourceError without secrets for errors of httpx."""
        self._network.until = time.monotonic() + self._whole_s
        try:
            yield
        except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError, OSError, ValueError) as error:
            why = self.login.redact(error)
            match error:
                case _ if time.monotonic() >= self._network.until:
                    said = f"the camera took more than {self._whole_s:g} s for one image"
                case httpx.TimeoutException():
                    what = "connection" if isinstance(error, httpx.ConnectTimeout) else "answer"
                    said = f"the camera does not respond: no {what} in time"
                case httpx.ConnectError():
                    remedies = (
                        remedy for text, remedy in _REMEDIES.items() if re.search(text, str(error), re.IGNORECASE)
                    )
                    said = f"no connection: {why}{next(remedies, '')}"
                case httpx.InvalidURL() | UnicodeError():
                    said = f"the url is invalid: {why}"
                case _:
                    said = f"the camera closed the connection or did not answer HTTP ({type(error).__name__}): {why}"
            raise SourceError(said) from None

    def _check(self, response: httpx.Response, accepted: Collection[int]) -> None:
        status = response.status_code
        if status in accepted:
            return
        if status in REFUSED:
            raise self.login.rejected(f"HTTP {status}")
        if 300 <= status < 400:
            place = self.login.redact(response.headers.get("location", "elsewhere"))
            page, remedy = "", "set this address as url"
            if _LOGIN.search(place):
                page, remedy = "its login page ", "check the url and the authentication"
            raise SourceError(f"the camera redirects to {page}{place} (HTTP {status}): {remedy}")
        raise SourceError(f"the camera answered HTTP {status} {response.reason_phrase}".rstrip())


def is_whole_jpeg(data: bytes | bytearray) -> bool:
    """Return whether data begins and ends as a JPEG; some cameras add line breaks or zeros."""
    return data.lstrip(b"\r\n")[:2] == b"\xff\xd8" and data.rstrip(b"\r\n\0")[-2:] == b"\xff\xd9"


_LOGIN = re.compile(r"(?i)log[io]n|signin|(?<![a-z])(log|sign)[\s_-]in(?![a-z])|password")


def page_in(body: bytes) -> str:
    """Return what a web page is that a camera sends instead of an image; empty: it is none."""
    text = body[:8192].decode("utf-8", "replace")
    if not re.search(r"(?i)<\s*(!doctype html|html|head|body|script|meta|title)\b", text):
        return ""
    title = re.search(r"(?is)<title[^>]*>\s*(.*?)\s*</title", text)
    place = re.search(r"(?i)(?:\burl=|location(?:\.href)?\s*=|location\.replace\()\s*['\"]?([^'\"\s>)]+)", text)
    kind = "its login page" if _LOGIN.search(text) else "a page" if place else "a web page"
    named = f' "{plain(redacted(title[1]), 60)}"' if title and title[1] else ""
    return kind + named + (f" that redirects to {plain(redacted(place[1]), 100)}" if place else "")


_REMEDIES = {
    r"hostname mismatch|ip address mismatch": "the certificate is for another host; set check_name: false (--any-name)",
    r"self.signed|unable to get": "save the camera's certificate as a PEM file, and name this file as ca (--ca)",
    r"expired|not yet valid": "renew the certificate in the camera, and check both clocks",
    r"wrong_version_number": "the port does not speak https; use http://, or another port",
}
"""What to do about an error of TLS, by its text."""


def http_time(headers: Headers, name: str) -> CameraTime | None:
    """Return a time from a header; None if missing or invalid. Whole seconds, as in RFC 9110."""
    try:
        return CameraTime(parsedate_to_datetime(headers[name]).timestamp(), 1.0, name.lower())
    except (KeyError, TypeError, ValueError, OverflowError):
        return None


def _certificates(settings: HttpSettings) -> ssl.SSLContext:
    """Return one SSL context for all connections with the same certificates, because reading the system's takes longer
    than connecting."""
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
