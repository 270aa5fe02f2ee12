"""Read PTZ heads of Hikvision (ISAPI) and Axis (VAPIX), and open those of any kind.

ISAPI: source: ISAPI 2.0, PTZCtrl; fields as cameras send them. Units differ between pages: tenths of a degree in
`status`, degrees with decimals in `absoluteEx`."""

import time
from collections.abc import Callable
from functools import partial

from ltm_core.site.source_config import IsapiConfig, OnvifConfig, PtzConfig, SourceConfig, VapixConfig
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.cameras.protocols.http_client import HttpClient
from ltm_ros.cameras.protocols.picture import PtzHead, PtzReading
from ltm_ros.cameras.ptz.head import MOST_BYTES, found, number, parsed_xml, settings_of
from ltm_ros.cameras.ptz.onvif import OnvifPtzHead


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
    """Return azimuth, elevation and zoom. On most of these PTZ heads, elevation grows downwards (0 level, 90 straight
    down): `mount.tilt_sign: -1`."""
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
