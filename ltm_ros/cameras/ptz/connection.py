"""Connect to a PTZ head: HTTP with the camera's user and password, and XML with limits."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree  # nosec B405 # documents with a DTD are refused before they are parsed
from collections.abc import Collection, Mapping
from urllib.parse import SplitResult, urlsplit, urlunsplit

from ltm_core.site.source_config import HttpSettings, NetworkSettings, PtzSettings, SourceConfig
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.cameras.protocols.http_client import TAKEN, HttpClient, HttpResponse

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
    SourceError.
    """
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


def span(root: ElementTree.Element, *names: str) -> tuple[float, float] | None:
    """Return the numbers Min and Max below an element; None: not reported. Raises SourceError."""
    place = found(root, *names)
    ends = [] if place is None else [e for e in (found(place, "Min"), found(place, "Max")) if e is not None]
    return (number(ends[0].text, names[-1]), number(ends[1].text, names[-1])) if len(ends) == 2 else None


def number(text: str | None, what: str) -> float:
    """Parse a number. Raises SourceError."""
    try:
        value = float((text or "").strip())
    except ValueError:
        value = float("nan")
    if not -1e9 < value < 1e9:
        raise SourceError(f"the PTZ head reports {text!r:.40} for {what}, which is not a number")
    return value
