"""A pan-tilt-zoom camera on loopback: a PTZ head that takes its time to turn, asked as those of Axis
(VAPIX), Hikvision (ISAPI) and ONVIF are; its pictures show where it really looks."""

import base64
import calendar
import hashlib
import math
import threading
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from ltm_core.base.types import UInt8Array
from scenes.http_camera import HttpCamera, Request, Route
from scenes.timed_picture import jpeg, scene, time_in, with_time

Place = tuple[float, float, float]
"""Pan (deg), tilt (deg), zoom, as VAPIX has them: pan clockwise, tilt upwards, zoom 1 to 9999."""

CLOCK_TOLERANCE_S = 5.0
"""By which a signed ONVIF request may be old."""
_SOAP = "http://www.w3.org/2003/05/soap-envelope"
_DAY = "%Y-%m-%dT%H:%M:%SZ"


@dataclass
class FakeHead:
    """Turns from where it is to where it was sent at `rate` deg/s, each axis for itself."""

    place: Place = (0.0, 0.0, 1.0)
    rate: float = 200.0
    starts_after_s: float = 0.05
    """After a command, during which it still reads as before."""
    onvif_inverted: bool = False
    """Its ONVIF pan runs anticlockwise, as one maker's does."""
    move_status: str | None = None
    """What ONVIF's MoveStatus says, always; None: it is missing."""
    user: str = ""
    password: str = ""
    """Of ONVIF's signed requests; empty: not looked at."""
    clock_ahead: float = 0.0
    time: str = "open"
    """Who may ask ONVIF for it: `open`: all; `signed`: who has the password; `none`: it is not said."""
    has_ptz: bool = True
    """By ONVIF."""
    stated_picture: str = "http://{}/snapshot.jpg"
    """By ONVIF; its own host in place of {}."""

    def __post_init__(self) -> None:
        self._from, self._to, self._begun = self.place, self.place, 0.0
        self._lock = threading.Lock()

    def send(self, place: Place) -> None:
        now = time.monotonic()
        with self._lock:
            self._from, self._to, self._begun = self._at(now), place, now + self.starts_after_s

    def slew(self, rate: float, seconds: float = 600.0) -> None:
        """Pan clockwise on and on."""
        pan, tilt, zoom = self.encoders()
        self.rate, self.starts_after_s = rate, 0.0
        self.send((pan + rate * seconds, tilt, zoom))

    def encoders(self) -> Place:
        with self._lock:
            return self._at(time.monotonic())

    def _at(self, now: float) -> Place:
        way = self.rate * max(0.0, now - self._begun)

        def moved(a: float, b: float, most: float) -> float:
            return b if abs(b - a) <= most else a + math.copysign(most, b - a)

        (p0, t0, z0), (p1, t1, z1) = self._from, self._to
        return moved(p0, p1, way), moved(t0, t1, way), moved(z0, z1, 50 * way)

    def routes(self) -> dict[str, Route]:
        base = "/ISAPI/PTZCtrl/channels/1"
        return {
            "/axis-cgi/com/ptz.cgi": self._vapix,
            "/axis-cgi/jpg/image.cgi": Request.snapshot,
            f"{base}/status": self._isapi_status,
            f"{base}/absoluteEx": self._isapi_absolute,
            "/onvif/device_service": self._onvif,
            "/onvif/media": self._onvif,
            "/onvif/ptz": self._onvif,
        }

    # --- VAPIX

    def _vapix(self, request: Request) -> None:
        pan, tilt, zoom = self.encoders()
        text = f"pan={(pan + 180) % 360 - 180:.4f}\r\ntilt={tilt:.4f}\r\nzoom={zoom:.0f}\r\nautofocus=on\r\n"
        known = parse_qs(urlsplit(request.path).query).get("query") == ["position"]
        request.answer(200, (text if known else "Error: unknown query\r\n").encode(), "text/plain")

    # --- ISAPI: elevation grows downwards

    def _isapi_status(self, request: Request) -> None:
        pan, tilt, zoom = self.encoders()
        inside = (
            f"<AbsoluteHigh><elevation>{round(-tilt * 10)}</elevation><azimuth>{round(pan % 360 * 10)}</azimuth>"
            f"<absoluteZoom>{round(zoom * 10)}</absoluteZoom></AbsoluteHigh>"
        )
        self._xml(request, f"<PTZStatus{_HIK}>{inside}</PTZStatus>")

    def _isapi_absolute(self, request: Request) -> None:
        pan, tilt, zoom = self.encoders()
        inside = f"<elevation>{-tilt:.2f}</elevation><azimuth>{pan % 360:.2f}</azimuth>"
        inside += f"<absoluteZoom>{zoom:.2f}</absoluteZoom>"
        self._xml(request, f"<PTZAbsoluteEx{_HIK}>{inside}</PTZAbsoluteEx>")

    def _xml(self, request: Request, body: str, status: int = 200) -> None:
        request.answer(status, f'<?xml version="1.0" encoding="UTF-8"?>{body}'.encode(), "application/xml")

    # --- ONVIF

    def _onvif(self, request: Request) -> None:
        root = ElementTree.fromstring(request.body)
        call = next(iter(root.find(f"{{{_SOAP}}}Body") or []))
        name = call.tag.rpartition("}")[2]
        if (name != "GetSystemDateAndTime" or self.time == "signed") and not self._signed(root):
            fault = (
                "<s:Fault><s:Code><s:Value>s:Sender</s:Value><s:Subcode><s:Value>ter:NotAuthorized</s:Value></s:Subcode>"
                '</s:Code><s:Reason><s:Text xml:lang="en">Sender not Authorized</s:Text></s:Reason></s:Fault>'
            )
            self._soap(request, fault, 400)
            return
        host = f"http://{request.headers['host']}/onvif"
        address = {element.tag.rpartition("}")[2]: element.text or "" for element in call.iter()}
        pan, tilt, zoom = self.encoders()
        if name == "GetSystemDateAndTime":
            now = time.gmtime(time.time() + self.clock_ahead)
            words = ["Year", "Month", "Day", "Hour", "Minute", "Second"]
            parts = [f"<tt:{word}>{value}</tt:{word}>" for word, value in zip(words, now[:6], strict=True)]
            date, hour = f"<tt:Date>{''.join(parts[:3])}</tt:Date>", f"<tt:Time>{''.join(parts[3:])}</tt:Time>"
            inside = "" if self.time == "none" else f"<tt:UTCDateTime>{hour}{date}</tt:UTCDateTime>"
        elif name == "GetCapabilities":
            inside = "".join(
                f"<tt:{service}><tt:XAddr>{host}/{service.lower()}</tt:XAddr></tt:{service}>"
                for service in ("Media", "PTZ")[: 1 + self.has_ptz]
            )
        elif name == "GetProfiles":
            head = "<tt:PTZConfiguration token='p'><tt:Name>p</tt:Name></tt:PTZConfiguration>"
            head *= self.has_ptz
            inside = f"<trt:Profiles token='still'/><trt:Profiles token='main'>{head}</trt:Profiles>"
        elif name in ("GetSnapshotUri", "GetStreamUri"):
            place = self.stated_picture if name == "GetSnapshotUri" else "rtsp://{}/stream"
            inside = f"<trt:MediaUri><tt:Uri>{place.format(request.headers['host'])}</tt:Uri></trt:MediaUri>"
        elif name == "GetStatus" and address["ProfileToken"] == "main":
            x = ((pan + 180) % 360 - 180) / 180 * (-1 if self.onvif_inverted else 1)
            status = "" if self.move_status is None else (
                f"<tt:MoveStatus><tt:PanTilt>{self.move_status}</tt:PanTilt></tt:MoveStatus>"
            )  # fmt: skip
            inside = (
                f'<tptz:PTZStatus><tt:Position><tt:PanTilt x="{x:.6f}" y="{tilt / 90:.6f}"/>'
                f'<tt:Zoom x="{(zoom - 1) / 9998:.6f}"/></tt:Position>{status}</tptz:PTZStatus>'
            )
        else:
            self._soap(request, "<s:Fault><s:Reason><s:Text>ActionNotSupported</s:Text></s:Reason></s:Fault>", 500)
            return
        self._soap(request, f"<x:{name}Response>{inside}</x:{name}Response>")

    def _signed(self, root: ElementTree.Element) -> bool:
        if not self.password:
            return True
        given = {element.tag.rpartition("}")[2]: element.text or "" for element in root.iter()}
        try:
            nonce, created = base64.b64decode(given["Nonce"]), given["Created"]
            age = time.time() + self.clock_ahead - calendar.timegm(time.strptime(created, _DAY))
        except (KeyError, ValueError):
            return False
        digest = hashlib.sha1(nonce + created.encode() + self.password.encode()).digest()
        right = given.get("Username") == self.user and given.get("Password") == base64.b64encode(digest).decode()
        return right and abs(age) <= CLOCK_TOLERANCE_S

    def _soap(self, request: Request, body: str, status: int = 200) -> None:
        names = " ".join(f'xmlns:{short}="http://www.onvif.org/{path}"' for short, path in _NAMES.items())
        self._xml(request, f'<s:Envelope xmlns:s="{_SOAP}" {names}><s:Body>{body}</s:Body></s:Envelope>', status)


_NAMES = {"tt": "ver10/schema", "trt": "ver10/media/wsdl", "tptz": "ver20/ptz/wsdl", "ter": "ver10/error", "x": "x"}
_HIK = ' version="2.0" xmlns="http://www.hikvision.com/ver20/XMLSchema"'


def ptz_camera(head: FakeHead, picture: Callable[[Place], UInt8Array] | None = None) -> HttpCamera:
    """Its pictures show where it looks: by `picture`, or as `with_direction` writes it."""
    camera = HttpCamera(routes=head.routes())
    draw = picture or with_direction
    camera.behaviour.render = lambda moment: jpeg(draw(head.encoders()))
    return camera


def with_direction(place: Place) -> UInt8Array:
    """A scene of its own for each ten degrees, with pan and tilt (hundredths of a degree) in squares."""
    pan, tilt, _ = place
    count = round(pan % 360 * 100) * 100_000 + round((tilt + 90) * 100)
    return with_time(scene(seed=int(pan % 360 // 10) + 100), count / 1000)


def direction_in(image: UInt8Array) -> tuple[float, float]:
    """Pan in [0, 360) and tilt, degrees: what `with_direction` wrote."""
    count = round(time_in(image) * 1000)
    return count // 100_000 / 100, count % 100_000 / 100 - 90
