"""Read PTZ heads of Axis (VAPIX), of Hikvision (ISAPI), and by ONVIF, with the necessary parts of SOAP and WS-Security.

Sources: ISAPI 2.0, PTZCtrl; fields as cameras send them. ONVIF Core Specification 5.9.4 (user authentication), OASIS
WS-Security UsernameToken Profile 1.0 (password digest). Own code, because onvif-zeep-async needs 27 packages and 57 MB;
six calls are needed here."""

import base64
import calendar
import hashlib
import secrets
import time
import xml.etree.ElementTree as ElementTree  # nosec B405 # parsed by `parsed_xml`
from collections.abc import Callable, Mapping
from functools import partial
from xml.sax.saxutils import escape  # nosec B406 # writes only

from ltm_core.site.source_config import IsapiConfig, OnvifConfig, PtzConfig, SourceConfig, VapixConfig
from ltm_ros.cameras.protocols.credentials import SourceError, UnauthorisedError
from ltm_ros.cameras.protocols.http_client import HttpClient
from ltm_ros.cameras.protocols.picture import PtzHead, PtzReading
from ltm_ros.cameras.ptz.head import MOST_BYTES, found, number, parsed_xml, settings_of, with_configured_host


class OneRequestHead:
    """A PTZ head that answers one request with pan, tilt and zoom; it reports neither the time of a reading nor
    motion."""

    def __init__(self, client: HttpClient, read: Callable[[HttpClient], tuple[float, float, float]]) -> None:
        self._client, self._read = client, read

    def read(self) -> PtzReading:
        return PtzReading(*self._read(self._client), None, time.monotonic())

    def close(self) -> None:
        self._client.close()


def _isapi(config: IsapiConfig, client: HttpClient) -> tuple[float, float, float]:
    """Return azimuth, elevation and zoom: tenths of a degree in `status`, degrees with decimals in `absoluteEx`.

    On most of these PTZ heads, elevation grows downwards (0 level, 90 straight down): `mount.tilt_sign: -1`."""
    page, place, scale = ("status", ("AbsoluteHigh",), 0.1) if config.units == "tenths" else ("absoluteEx", (), 1.0)
    root = parsed_xml(client.get(f"/ISAPI/PTZCtrl/channels/{config.channel}/{page}").body)
    values = []
    for name in ("azimuth", "elevation", "absoluteZoom"):
        element = found(root, *place, name)
        if element is None:
            raise SourceError(f"the PTZ head's page {page} contains no {name}: set ptz.units to the other units")
        values.append(number(element.text, name))
    return values[0] * scale, values[1] * scale, values[2]


def _vapix(config: VapixConfig, client: HttpClient) -> tuple[float, float, float]:
    """Return pan (clockwise), tilt (upwards) and zoom, in degrees."""
    answer = client.get(f"/axis-cgi/com/ptz.cgi?query=position&camera={config.camera}", accepted=(200,))
    text = answer.body.decode("utf-8", "replace")
    if text.lstrip().lower().startswith("error"):
        raise SourceError(f"the PTZ head answered {text.strip()[:80]!r}")
    lines = (line.partition("=") for line in text.splitlines())
    said = {name.strip(): value.strip() for name, sign, value in lines if sign}
    if not said:
        raise SourceError("the camera reports no position by VAPIX: it has no PTZ head, or uses another protocol")
    return number(said.get("pan"), "pan"), number(said.get("tilt"), "tilt"), number(said.get("zoom", "1"), "zoom")


DEVICE = "http://www.onvif.org/ver10/device/wsdl"
MEDIA = "http://www.onvif.org/ver10/media/wsdl"
PTZ = "http://www.onvif.org/ver20/ptz/wsdl"
_SCHEMA = "http://www.onvif.org/ver10/schema"
STREAM_SETUP = (
    f'<StreamSetup><Stream xmlns="{_SCHEMA}">RTP-Unicast</Stream>'
    f'<Transport xmlns="{_SCHEMA}"><Protocol>RTSP</Protocol></Transport></StreamSetup>'
)
_WSSE = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss-wssecurity-secext-1.0.xsd"
_WSU = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss-wssecurity-utility-1.0.xsd"
_DIGEST = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss-username-token-profile-1.0#PasswordDigest"
_BASE64 = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss-soap-message-security-1.0#Base64Binary"
_REFUSALS = ("NotAuthorized", "SenderNotAuthorized", "FailedAuthentication", "Sender not authorized")
_CLOCKS_AGREE_S = 5.0
"""Seconds by which a camera's clock may be off without being a reason to reject a request."""
_TOLD = (200, 400, 401, 403, 500)
"""A fault is also an answer; cameras send it with any of these statuses."""


class SoapClient:
    """Signs with the camera's own time, which it requests first: a token older than some seconds is rejected, and
    cameras' clocks are off by minutes."""

    def __init__(self, client: HttpClient, device: str) -> None:
        self._client, self._device, self._login = client, device, client.login
        self._ahead: float | None = None

    def clock_ahead(self) -> float | None:
        """Return the seconds by which the camera's clock is ahead of this computer's; None: not reported."""
        before, question = time.time(), _call(DEVICE, "GetSystemDateAndTime")
        try:
            root = self._send(self._device, question, signed=False)
        except UnauthorisedError:
            # Some cameras require a login even for the time: assume that both clocks agree.
            self._ahead = 0.0
            root = self._send(self._device, question, signed=True)
        middle = (before + time.time()) / 2
        utc = found(root, "UTCDateTime")
        if utc is None:
            self._ahead = 0.0
            return None
        names = ("Year", "Month", "Day", "Hour", "Minute", "Second")
        fields = [int(number(getattr(found(utc, name), "text", None), name)) for name in names]
        try:
            # It reports whole seconds, at their start.
            self._ahead = calendar.timegm((*fields, 0, 0, 0)) + 0.5 - middle
        except (ValueError, OverflowError):
            raise SourceError(f"the camera reports an invalid time: {fields}") from None
        return self._ahead

    def call(
        self, address: str, namespace: str, name: str, arguments: Mapping[str, str] | None = None, before: str = ""
    ) -> ElementTree.Element:
        """Return the body of the answer. `before`: XML before the arguments. Raises SourceError, UnauthorisedError."""
        if self._ahead is None:
            self.clock_ahead()
        body = _call(namespace, name, arguments, before)
        try:
            return self._send(address, body, signed=True)
        except UnauthorisedError:
            # Its clock may have been set meanwhile: try once more before the password counts as wrong.
            known = self._ahead or 0.0
            ahead = self.clock_ahead() or 0.0
            if abs(ahead - known) < 2.0:
                if abs(ahead) > _CLOCKS_AGREE_S:
                    raise self._login.rejected(f"ONVIF, NotAuthorized; camera clock {ahead:+.0f} s off") from None
                raise
            return self._send(address, body, signed=True)

    def _send(self, address: str, body: str, signed: bool) -> ElementTree.Element:
        header = self._security() if signed and self._login.user else ""
        envelope = (
            '<?xml version="1.0" encoding="UTF-8"?>'
            '<s:Envelope xmlns:s="http://www.w3.org/2003/05/soap-envelope">'
            f"<s:Header>{header}</s:Header><s:Body>{body}</s:Body></s:Envelope>"
        )
        kind = {"content-type": "application/soap+xml; charset=utf-8"}
        answer = self._client.get(address, kind, envelope.encode(), accepted=_TOLD)
        if answer.status in (401, 403) and b"Envelope" not in answer.body:
            raise self._login.rejected(f"ONVIF, HTTP {answer.status}")
        root = parsed_xml(answer.body)
        fault = found(root, "Fault")
        if fault is not None:
            said = " ".join("".join(fault.itertext()).split())
            if any(refusal in said for refusal in _REFUSALS):
                raise self._login.rejected("ONVIF, NotAuthorized")
            raise SourceError(f"the camera rejected the ONVIF request: {self._login.redact(said)[:120]}")
        inside = found(root, "Body")
        if inside is None:
            raise SourceError(
                f"the camera answered <{root.tag.rpartition('}')[2][:40]}> instead of SOAP: check url and path of ptz"
            )
        return inside

    def _security(self) -> str:
        nonce = secrets.token_bytes(16)
        created = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(time.time() + (self._ahead or 0.0)))
        # The standard requires SHA-1 here.
        digest = hashlib.sha1(nonce + created.encode() + self._login.secret.encode(), usedforsecurity=False).digest()
        return (
            f'<wsse:Security xmlns:wsse="{_WSSE}" xmlns:wsu="{_WSU}"><wsse:UsernameToken>'
            f"<wsse:Username>{escape(self._login.user or '')}</wsse:Username>"
            f'<wsse:Password Type="{_DIGEST}">{base64.b64encode(digest).decode()}</wsse:Password>'
            f'<wsse:Nonce EncodingType="{_BASE64}">{base64.b64encode(nonce).decode()}</wsse:Nonce>'
            f"<wsu:Created>{created}</wsu:Created></wsse:UsernameToken></wsse:Security>"
        )


def _call(namespace: str, name: str, arguments: Mapping[str, str] | None = None, before: str = "") -> str:
    inside = "".join(f"<{key}>{escape(value)}</{key}>" for key, value in (arguments or {}).items())
    return f'<{name} xmlns="{namespace}">{before}{inside}</{name}>'


_DEGREES = "SphericalPositionSpaceDegrees"


class OnvifPtzHead:
    """The directions of its axes differ between makers, even from its own velocities: calibrate the mount's signs (`ltm
    pose`). MoveStatus is often missing or constant, so it is used only if it reports motion."""

    def __init__(self, config: OnvifConfig, client: HttpClient) -> None:
        self._config, self._client = config, client
        self._device = client.url + config.path
        self.soap = SoapClient(client, self._device)
        self._services: ElementTree.Element | None = None
        self._profile = config.profile

    def read(self) -> PtzReading:
        root = self.soap.call(self._service("PTZ"), PTZ, "GetStatus", {"ProfileToken": self._token()})
        at = time.monotonic()
        turn, zoom = found(root, "Position", "PanTilt"), found(root, "Position", "Zoom")
        if turn is None:
            raise SourceError(
                "the PTZ head reports no position by ONVIF (GetStatus without PanTilt): it is not supported"
            )
        x, y = number(turn.get("x"), "pan"), number(turn.get("y"), "tilt")
        if _DEGREES not in (turn.get("space") or ""):
            ranges = self._config.pan_range_deg, self._config.tilt_range_deg
            x, y = (low + (value + 1) / 2 * (high - low) for value, (low, high) in zip((x, y), ranges, strict=True))
        status = found(root, "MoveStatus", "PanTilt")
        moving = True if status is not None and (status.text or "").strip() == "MOVING" else None
        return PtzReading(x, y, 0.0 if zoom is None else number(zoom.get("x"), "zoom"), moving, at)

    def picture_addresses(self) -> tuple[str | None, str | None]:
        """Return the URLs of a snapshot and of a stream that the camera reports."""
        media, token = self._service("Media"), {"ProfileToken": self._token(with_ptz=False)}

        def uri(name: str, setup: str = "") -> str | None:
            try:
                return getattr(found(self.soap.call(media, MEDIA, name, token, setup), "Uri"), "text", None)
            except UnauthorisedError:
                raise
            except SourceError:
                return None

        return uri("GetSnapshotUri"), uri("GetStreamUri", STREAM_SETUP)

    def close(self) -> None:
        self._client.close()

    def _service(self, name: str) -> str:
        """Return the address of a service, at the configured host. Raises SourceError if the camera lacks it."""
        if self._services is None:
            self._services = self.soap.call(self._device, DEVICE, "GetCapabilities", {"Category": "All"})
        address = found(self._services, name, "XAddr")
        if address is None or not address.text:
            what = "no PTZ head" if name == "PTZ" else "no images"
            raise SourceError(f"the camera has {what} by ONVIF (no service {name})")
        return with_configured_host(address.text, self._client.url)

    def _token(self, with_ptz: bool = True) -> str:
        """Return the token of the first media profile, of those with a PTZ head if there are any."""
        if self._profile is not None:
            return self._profile
        root = self.soap.call(self._service("Media"), MEDIA, "GetProfiles")
        profiles = {token: e for e in root.iterfind(".//{*}Profiles") if (token := e.get("token"))}
        turning = [token for token, e in profiles.items() if found(e, "PTZConfiguration") is not None]
        if not turning and (with_ptz or not profiles):
            what = "has a PTZ head" if profiles else "exists"
            raise SourceError(f"no media profile of the camera {what}: select or add one in the camera's settings")
        self._profile = turning[0] if turning else None
        return self._profile or next(iter(profiles))


def open_ptz(config: PtzConfig, source: SourceConfig | None, client: HttpClient | None = None) -> PtzHead:
    """Open a PTZ head without a request. `client`: an existing connection. Raises SourceError, and UnauthorisedError if
    the password cannot be read."""
    client = client or HttpClient(settings_of(config, source), most_bytes=MOST_BYTES)
    match config:
        case VapixConfig():
            return OneRequestHead(client, partial(_vapix, config))
        case IsapiConfig():
            return OneRequestHead(client, partial(_isapi, config))
        case OnvifConfig():
            return OnvifPtzHead(config, client)
