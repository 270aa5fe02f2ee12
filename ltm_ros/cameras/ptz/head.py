"""Connect to PTZ heads of all makers and read their directions, with readings close enough to detect motion."""

import re
import time
import xml.etree.ElementTree as ElementTree  # nosec B405 # documents with a DTD are refused before they are parsed
from collections.abc import Callable
from urllib.parse import SplitResult, urlsplit, urlunsplit

from ltm_core.site.source_config import HttpSettings, NetworkSettings, PtzConfig, PtzSettings, SourceConfig
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.cameras.protocols.picture import PtzHead, PtzReading, Tolerance, stated_number

_REST = {
    "vapix": Tolerance(0.05, 1.0),
    "isapi tenths": Tolerance(0.15, 1.0),
    "isapi degrees": Tolerance(0.05, 0.1),
    "onvif": Tolerance(0.05, 0.002),
}
"""Differences of two readings at rest: a few units of the last digit."""


def tolerance_of(config: PtzConfig) -> Tolerance:
    """Return the difference of two readings at rest."""
    usual = _REST[" ".join(filter(None, (config.kind, getattr(config, "units", None))))]
    return Tolerance(config.tolerance_deg or usual.angle_deg, usual.zoom)


SLOWEST_DEG_S = 1.0
"""Slowest rotation in deg/s that is distinguished from rest."""


class PtzDirection:
    """Reads a PTZ head; for one thread.

    Args: open_ptz: raises SourceError, UnauthorisedError. tolerance: of readings at rest; they are far enough apart for
    twice of it, so that flicker of the last digit hides no motion."""

    def __init__(self, open_ptz: Callable[[], PtzHead], tolerance: Tolerance) -> None:
        self._open, self._spacing_s = open_ptz, 2 * tolerance.angle_deg / SLOWEST_DEG_S
        self._ptz: PtzHead | None = None
        self._last_at = 0.0

    def read(self) -> PtzReading:
        """Return a reading after waiting long enough to detect a slow rotation; fractions of a second."""
        if self._ptz is None:
            self._ptz = self._open()
        time.sleep(max(0.0, self._last_at + self._spacing_s - time.monotonic()))
        reading = self._ptz.read()
        self._last_at = reading.at
        return reading

    def close(self) -> None:
        """Close the connection; `read` opens a new one."""
        ptz, self._ptz = self._ptz, None
        if ptz is not None:
            ptz.close()


MOST_BYTES = 512 << 10
"""Maximum bytes of an answer."""

_DTD = re.compile(rb"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)


def settings_of(ptz: PtzSettings, source: SourceConfig | None) -> HttpSettings:
    """Return the section `ptz`, completed from the camera's `source`."""
    given = ptz.model_dump(include={"url", "user", "password", "ca", "check_name", "authentication", "timeout"})
    if isinstance(source, NetworkSettings):
        if ptz.url is None:
            parts = urlsplit(source.url)
            # A stream's port is not that of the camera's web pages.
            place = parts.netloc if parts.scheme in ("http", "https") else host_of(source.url)
            given["url"] = f"{'https' if parts.scheme == 'https' else 'http'}://{place}"
        if ptz.user is None:
            given |= source.model_dump(include={"user", "password"})
    if isinstance(source, HttpSettings) and ptz.ca is None:
        given |= {"ca": source.ca, "check_name": source.check_name}
    if given["url"] is None:
        raise SourceError("the PTZ head has no address: set ptz.url in the site file")
    return HttpSettings.model_validate(given | {"url": given["url"].rstrip("/")})


def parsed_xml(body: bytes) -> ElementTree.Element:
    """Parse XML. Raises SourceError if it is invalid or defines entities, which can expand without limit."""
    # In UTF-16, a DTD would go unnoticed.
    if _DTD.search(body.replace(b"\0", b"")):
        raise SourceError("the camera sent XML with a document type, which is not allowed")
    try:
        return ElementTree.fromstring(body)  # nosec B314 # see above
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SourceError(f"the camera sent no valid XML ({error}): check url and kind of ptz") from None


def split_address(url: str) -> SplitResult:
    """Split an address reported by a camera. Raises SourceError if it is invalid."""
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError:
        raise SourceError(f"the camera reported an invalid address: {url[:60]!r}") from None
    return parts


def host_of(url: str) -> str:
    """Return the host of an address, as a URL has it."""
    host = split_address(url).hostname or ""
    return f"[{host}]" if ":" in host else host


def with_configured_host(stated: str, asked: str) -> str:
    """Return an address reported by the camera with scheme, host and port of `asked`: behind a gateway cameras report
    other hosts, and a password goes only to the configured host. A stream keeps its scheme and port. Raises
    SourceError."""
    parts, own = split_address(stated.strip()), split_address(asked)
    if parts.scheme in ("rtsp", "rtsps"):
        place = host_of(asked) + (f":{parts.port}" if parts.port else "")
        return urlunsplit((parts.scheme, place, parts.path, parts.query, ""))
    return urlunsplit((own.scheme, own.netloc, parts.path, parts.query, ""))


def found(root: ElementTree.Element, *names: str) -> ElementTree.Element | None:
    """Return the first element below others of these names, in this order, at any depth, in any namespace: cameras of
    one maker vary it. One name at a time, because a single path of several takes minutes on deeply nested XML."""
    here: ElementTree.Element | None = root
    for name in names:
        here = None if here is None else here.find(f".//{{*}}{name}")
    return here


def number(text: str | None, what: str) -> float:
    """Parse a number. Raises SourceError."""
    value = stated_number(text)
    if value is None or not -1e9 < value < 1e9:
        raise SourceError(f"the PTZ head reports {text!r:.40} for {what}, which is not a number")
    return value
