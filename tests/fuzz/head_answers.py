"""What PTZ heads of pan-tilt-zoom cameras answer."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from fuzz.mutations import spoil_text
from fuzz.target import Target
from ltm_core.site.source_config import PtzConfig
from ltm_ros.cameras.protocols.credentials import Login
from ltm_ros.cameras.protocols.http_client import HttpResponse
from ltm_ros.cameras.ptz.makers import open_ptz

_VAPIX = b"pan=12.5\r\ntilt=-3.25\r\nzoom=120\r\nautofocus=on\r\n"
_ISAPI = b"""<PTZStatus version="2.0" xmlns="http://www.hikvision.com/ver20/XMLSchema"><AbsoluteHigh>
<elevation>-33</elevation><azimuth>1234</azimuth><absoluteZoom>10</absoluteZoom></AbsoluteHigh>
<AbsolutePanTiltPositionSpace><XRange><Min>0</Min><Max>3600</Max></XRange></AbsolutePanTiltPositionSpace></PTZStatus>"""
_ONVIF = b"""<s:Envelope xmlns:s="http://www.w3.org/2003/05/soap-envelope" xmlns:t="http://www.onvif.org/ver10/schema"><s:Body>
<t:UTCDateTime><t:Time><t:Hour>1</t:Hour><t:Minute>2</t:Minute><t:Second>3</t:Second></t:Time>
<t:Date><t:Year>2026</t:Year><t:Month>5</t:Month><t:Day>6</t:Day></t:Date></t:UTCDateTime>
<t:Media><t:XAddr>http://127.0.0.1/m</t:XAddr></t:Media><t:PTZ><t:XAddr>http://127.0.0.1/p?a=b</t:XAddr></t:PTZ>
<t:Profiles token="main"><t:PTZConfiguration/></t:Profiles>
<t:Position><t:PanTilt x="0.25" y="-0.5"/><t:Zoom x="0.1"/></t:Position>
<t:MoveStatus><t:PanTilt>IDLE</t:PanTilt></t:MoveStatus>
</s:Body></s:Envelope>"""


class _Answering:
    """A connection that answers the same to everything."""

    url, login = "http://127.0.0.1", Login(None, None)

    def __init__(self, body: bytes) -> None:
        self._body = body

    def get(self, *asked: Any, **how: Any) -> HttpResponse:
        headers: Mapping[str, str] = {}
        return HttpResponse(200, headers, self._body, 0.0, 0.0)

    def close(self) -> None:
        """There is nothing to close."""


def _head(name: str, seed: bytes, **config: object) -> Target:
    def read(folder: Path) -> None:
        adapter: TypeAdapter[Any] = TypeAdapter(PtzConfig)
        answering: Any = _Answering((folder / "answer").read_bytes())
        open_ptz(adapter.validate_python(config), None, answering).read()

    return Target(name, "answer", lambda folder: [seed], read, spoil_text)


HEAD_ANSWERS = (
    _head("head_vapix", _VAPIX, kind="vapix", url="http://127.0.0.1"),
    _head("head_isapi", _ISAPI, kind="isapi", units="tenths", url="http://127.0.0.1"),
    _head("head_onvif", _ONVIF, kind="onvif", url="http://127.0.0.1"),
)
