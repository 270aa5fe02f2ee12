"""One connection to a PTZ head: HTTP with the camera's user and password, and XML within bounds."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree  # nosec B405 # documents with a DTD are refused before they are parsed
from collections.abc import Collection, Mapping
from urllib.parse import SplitResult, urlsplit, urlunsplit

from ltm_core.site.source_config import HttpSettings, NetworkSettings, PtzSettings, SourceConfig
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.cameras.protocols.http_client import TAKEN, HttpClient, HttpResponse

MOST_BYTES = 512 << 10
"""Of an answer: 256 presets of ONVIF have 120 kB."""

_DTD = re.compile(rb"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)


def settings_of(ptz: PtzSettings, source: SourceConfig | None) -> HttpSettings:
    """With what the section `ptz` leaves out taken from the camera's `source`."""
    url, user, password, ca, check_name = ptz.url, ptz.user, ptz.password, ptz.ca, ptz.check_name
    if isinstance(source, NetworkSettings):
        if url is None:
            parts = urlsplit(source.url)
            # A stream's port is not that of its camera's pages.
            place = parts.netloc if parts.scheme in ("http", "https") else (parts.hostname or "")
            url = f"{'https' if parts.scheme == 'https' else 'http'}://{place}"
        if user is None:
            user, password = source.user, source.password
    if isinstance(source, HttpSettings) and ca is None:
        ca, check_name = source.ca, source.check_name
    if url is None:
        raise SourceError("the PTZ head has no address: write it as ptz.url in the site file")
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
    """For one thread."""

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
        """Raises SourceError, UnauthorisedError."""
        url = path if path.startswith(("http://", "https://")) else self.settings.url + path
        return self._client.send(method, url, headers, body, accepted)


def parsed_xml(body: bytes) -> ElementTree.Element:
    """Raises SourceError for what is no XML, and for XML that defines entities, which can grow without bounds."""
    # In UTF-16 one would not be seen.
    if _DTD.search(body.replace(b"\0", b"")):
        raise SourceError("the camera sends XML with a document type, which is not read: no camera needs one")
    try:
        return ElementTree.fromstring(body)  # nosec B314 # see above
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SourceError(f"the camera sends no XML ({error}): check url and kind of ptz") from None


def split_address(url: str) -> SplitResult:
    """Raises SourceError for an address that a camera states and that is none."""
    try:
        return urlsplit(url)
    except ValueError:
        raise SourceError(f"the camera states an address that is none: {url[:60]!r}") from None


def at_asked_host(stated: str, asked: str) -> str:
    """The address that a camera states, with scheme, host and port of `asked`: behind a gateway cameras state others,
    and a password goes nowhere but to the host that its owner has named. Raises SourceError.
    """
    parts, own = split_address(stated.strip()), split_address(asked)
    return urlunsplit((own.scheme, own.netloc, parts.path, parts.query, ""))


def local(element: ElementTree.Element) -> str:
    """The name of an element without its namespace: cameras of one maker disagree about theirs."""
    return element.tag.rpartition("}")[2]


def found(root: ElementTree.Element, *names: str) -> ElementTree.Element | None:
    """The first element that stands below others of these names, in this order, at any depth."""
    here: ElementTree.Element | None = root
    for name in names:
        if here is None:
            return None
        here = next((e for e in here.iter() if e is not here and local(e) == name), None)
    return here


def number(text: str | None, what: str) -> float:
    """Raises SourceError."""
    try:
        value = float((text or "").strip())
    except ValueError:
        value = float("nan")
    if not -1e9 < value < 1e9:
        raise SourceError(f"the PTZ head says {text!r:.40} for {what}: that is no number")
    return value
