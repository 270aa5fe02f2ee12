"""Connect to PTZ heads of all makers and read their directions, with readings close enough to detect motion."""

from __future__ import annotations

import re
import time
import xml.etree.ElementTree as ElementTree  # nosec B405 # documents with a DTD are refused before they are parsed
from collections.abc import Callable, Collection, Mapping
from typing import Protocol
from urllib.parse import SplitResult, urlsplit, urlunsplit

from ltm_core.site.source_config import (
    HttpSettings,
    IsapiConfig,
    NetworkSettings,
    OnvifConfig,
    PatrolConfig,
    PtzConfig,
    PtzSettings,
    SourceConfig,
    VapixConfig,
)
from ltm_ros.cameras.protocols.credentials import SourceError, StuckPtzError
from ltm_ros.cameras.protocols.http_client import TAKEN, HttpClient, HttpResponse
from ltm_ros.cameras.protocols.picture import PtzReading, Tolerance, at_rest


class PtzHead(Protocol):
    """A `Direction` with presets. Only `go_to` moves the head.

    Every method raises SourceError without an answer, and UnauthorisedError if the password is rejected."""

    spacing: float
    """Seconds between two readings that detect a rotation of 1 deg/s."""

    def read(self) -> PtzReading: ...

    def presets(self) -> Mapping[str, str]:
        """Return the PTZ head's tokens of its presets, by name."""
        ...

    def go_to(self, preset: str) -> None:
        """Start moving to a preset and return at once. Raises SourceError for an unknown name."""
        ...

    def close(self) -> None: ...


def token_of(presets: Mapping[str, str], preset: str) -> str:
    """Return the token of a preset. Raises SourceError that lists the presets."""
    if preset not in presets:
        raise SourceError(f"the PTZ head has no preset {preset!r}; it has {', '.join(presets) or 'none'}")
    return presets[preset]


def tolerance_of(config: PtzConfig) -> Tolerance:
    """Return the difference of two readings at rest: a few units of the last digit."""
    match config:
        case VapixConfig():
            return Tolerance(config.tolerance_deg or 0.05, 1.0)
        case IsapiConfig():
            usual, zoom = (0.15, 1.0) if config.units == "tenths" else (0.05, 0.1)
            return Tolerance(config.tolerance_deg or usual, zoom)
        case OnvifConfig():
            return Tolerance(config.tolerance_deg or 0.05, 0.002)


SLOWEST_DEG_S = 1.0
"""Slowest rotation in deg/s that is distinguished from rest."""


def spacing_for(tolerance_deg: float) -> float:
    """Return the spacing for twice the tolerance, so that flicker of the last digit hides no motion."""
    return 2 * tolerance_deg / SLOWEST_DEG_S


STARTS_WITHIN_S = 2.0
"""Seconds within which a PTZ head starts to move after a command."""
SAME_PRESET_DEG = 0.5
"""Degrees by which a PTZ head may miss a preset before this is reported."""


class PtzDirection:
    """Reads a PTZ head; for one thread.

    Args: open_head: raises SourceError, UnauthorisedError. sleep, now: replace `time.sleep` and `time.monotonic` in
    tests."""

    def __init__(
        self,
        open_ptz: Callable[[], PtzHead],
        sleep: Callable[[float], None] = time.sleep,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._open, self._sleep, self._now = open_ptz, sleep, now
        self._ptz: PtzHead | None = None
        self._last: PtzReading | None = None

    def read(self) -> PtzReading:
        """Return a reading after waiting long enough to detect a slow rotation; fractions of a second."""
        ptz = self.ptz()
        if self._last is not None:
            self._sleep(max(0.0, self._last.at + ptz.spacing - self._now()))
        self._last = ptz.read()
        return self._last

    def ptz(self) -> PtzHead:
        if self._ptz is None:
            self._ptz = self._open()
        return self._ptz

    @property
    def now(self) -> float:
        return self._now()

    def close(self) -> None:
        ptz, self._ptz = self._ptz, None
        self._last = None
        if ptz is not None:
            ptz.close()


class PtzPatrol:
    """Moves a PTZ head as its only controller: readings between its commands must match them."""

    def __init__(self, direction: PtzDirection, config: PatrolConfig, tolerance: Tolerance) -> None:
        self._direction, self._config, self._tolerance = direction, config, tolerance
        self._next = 0
        self._at: str | None = None
        self._places: dict[str, PtzReading] = {}
        """Position of each preset at the first visit."""

    def advance(self) -> None:
        """Go to the next preset and wait until it rests. Raises StuckPtzError if the head does not move or does not
        stop, SourceError without an answer or if another controller has moved it."""
        preset = self._config.presets[self._next]
        before = self._direction.read()
        self._direction.ptz().go_to(preset)
        reading = self._arrived(preset, before)
        self._check(preset, before, reading)
        self._places.setdefault(preset, reading)
        self._at = preset
        self._next = (self._next + 1) % len(self._config.presets)

    def _arrived(self, preset: str, before: PtzReading) -> PtzReading:
        """Wait for two equal readings after the start of the motion, and two more after settling."""
        begun = self._direction.now
        until = begun + self._config.arrive_within
        known = self._places.get(preset)
        started = known is not None and self._same(before, known)
        last = before
        rested_since: float | None = None
        while True:
            reading = self._direction.read()
            still = self._same(last, reading)
            started = started or not self._same(before, reading) or reading.at - begun > STARTS_WITHIN_S
            if not (started and still):
                rested_since = None
            elif rested_since is None:
                rested_since = reading.at
            elif reading.at - rested_since >= self._config.settle:
                return reading
            if self._direction.now > until:
                raise StuckPtzError(
                    f"sent to preset {preset!r}, the PTZ head did not come to rest within "
                    f"{self._config.arrive_within:g} s; it reads pan {reading.pan_deg:.2f}, tilt "
                    f"{reading.tilt_deg:.2f}"
                )
            last = reading

    def _check(self, preset: str, before: PtzReading, reading: PtzReading) -> None:
        known = self._places.get(preset)
        if known is not None and not at_rest(known, reading, Tolerance(SAME_PRESET_DEG, self._tolerance.zoom * 10)):
            if self._same(before, reading):
                raise StuckPtzError(
                    f"sent to preset {preset!r} (pan {known.pan_deg:.2f}, tilt {known.tilt_deg:.2f}), the PTZ "
                    f"head stays at pan {reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}: it is stuck, or "
                    "another program moves it"
                )
            self._places[preset], self._at = reading, preset
            raise SourceError(
                f"preset {preset!r} was at pan {known.pan_deg:.2f}, tilt {known.tilt_deg:.2f}, and is now at pan "
                f"{reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}: it was changed, or another program moves "
                "the PTZ head"
            )
        other = self._at is not None and self._at != preset
        if known is None and other and self._same(before, reading):
            raise StuckPtzError(
                f"sent from preset {self._at!r} to {preset!r}, the PTZ head reads the same direction, pan "
                f"{reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}: it is stuck"
            )

    def _same(self, first: PtzReading, second: PtzReading) -> bool:
        return at_rest(first, second, self._tolerance)


MOST_BYTES = 512 << 10
"""Maximum bytes of an answer: 256 presets of ONVIF have 120 kB."""

_DTD = re.compile(rb"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)


def settings_of(ptz: PtzSettings, source: SourceConfig | None) -> HttpSettings:
    """Return the section `ptz`, completed from the camera's `source`."""
    url, user, password, ca, check_name = ptz.url, ptz.user, ptz.password, ptz.ca, ptz.check_name
    if isinstance(source, NetworkSettings):
        if url is None:
            parts = urlsplit(source.url)
            # A stream's port is not that of the camera's web pages.
            place = parts.netloc if parts.scheme in ("http", "https") else host_of(source.url)
            url = f"{'https' if parts.scheme == 'https' else 'http'}://{place}"
        if user is None:
            user, password = source.user, source.password
    if isinstance(source, HttpSettings) and ca is None:
        ca, check_name = source.ca, source.check_name
    if url is None:
        raise SourceError("the PTZ head has no address: set ptz.url in the site file")
    return HttpSettings(
        url=url.rstrip("/"),
        user=user,
        password=password,
        ca=ca,
        check_name=check_name,
        authentication=ptz.authentication,
        timeout=ptz.timeout,
    )


class Connection:
    """A connection for one thread."""

    def __init__(self, settings: HttpSettings) -> None:
        self.settings = settings
        self._client = HttpClient(settings, most_bytes=MOST_BYTES)

    def close(self) -> None:
        self._client.close()

    def ask(
        self,
        path: str,
        method: str = "GET",
        body: bytes | None = None,
        headers: Mapping[str, str] | None = None,
        accepted: Collection[int] = TAKEN,
    ) -> HttpResponse:
        """Send a request. Raises SourceError, UnauthorisedError."""
        url = path if path.startswith(("http://", "https://")) else self.settings.url + path
        return self._client.send(method, url, headers, body, accepted)


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
        return urlsplit(url)
    except ValueError:
        raise SourceError(f"the camera reported an invalid address: {url[:60]!r}") from None


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
        try:
            port = f":{parts.port}" if parts.port else ""
        except ValueError:
            raise SourceError(f"the camera reported an invalid address: {stated[:60]!r}") from None
        return urlunsplit((parts.scheme, host_of(asked) + port, parts.path, parts.query, ""))
    return urlunsplit((own.scheme, own.netloc, parts.path, parts.query, ""))


def local(element: ElementTree.Element) -> str:
    """Return an element's name without its namespace, which cameras of one maker vary."""
    return element.tag.rpartition("}")[2]


def found(root: ElementTree.Element, *names: str) -> ElementTree.Element | None:
    """Return the first element below others of these names, in this order, at any depth."""
    here: ElementTree.Element | None = root
    for name in names:
        if here is None:
            return None
        here = next((e for e in here.iter() if e is not here and local(e) == name), None)
    return here


def number(text: str | None, what: str) -> float:
    """Parse a number. Raises SourceError."""
    try:
        value = float((text or "").strip())
    except ValueError:
        value = float("nan")
    if not -1e9 < value < 1e9:
        raise SourceError(f"the PTZ head reports {text!r:.40} for {what}, which is not a number")
    return value
