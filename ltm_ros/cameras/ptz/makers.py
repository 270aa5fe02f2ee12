"""Read PTZ heads of Hikvision (ISAPI) and Axis (VAPIX).

ISAPI: source: ISAPI 2.0, PTZCtrl; fields as cameras send them. Units differ between pages: tenths of a degree in
`status`, degrees with decimals in `absoluteEx`."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from urllib.parse import quote

from ltm_core.site.source_config import (
    IsapiConfig,
    OnvifConfig,
    PtzConfig,
    SourceConfig,
    VapixConfig,
)
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.cameras.protocols.picture import PtzReading
from ltm_ros.cameras.ptz.head import (
    Connection,
    PtzHead,
    found,
    local,
    number,
    parsed_xml,
    settings_of,
    spacing_for,
    token_of,
    tolerance_of,
)
from ltm_ros.cameras.ptz.onvif import OnvifPtzHead


class IsapiPtzHead:
    """Azimuth is its pan, elevation its tilt. On most of these PTZ heads, elevation grows downwards (0 level, 90
    straight down): `mount.tilt_sign: -1`."""

    def __init__(self, config: IsapiConfig, source: SourceConfig | None, connection: Connection | None = None) -> None:
        self._connection = connection or Connection(settings_of(config, source))
        self._base = f"/ISAPI/PTZCtrl/channels/{config.channel}"
        self._tenths = config.units == "tenths"
        self.spacing = spacing_for(tolerance_of(config).angle_deg)

    def read(self) -> PtzReading:
        page, place = ("status", ("AbsoluteHigh",)) if self._tenths else ("absoluteEx", ())
        root = parsed_xml(self._connection.ask(f"{self._base}/{page}").body)
        at = time.monotonic()
        values = []
        for name in ("azimuth", "elevation", "absoluteZoom"):
            element = found(root, *place, name)
            if element is None:
                raise SourceError(f"the PTZ head's page {page} contains no {name}: set ptz.units to the other units")
            values.append(number(element.text, name))
        scale = 0.1 if self._tenths else 1.0
        return PtzReading(values[0] * scale, values[1] * scale, values[2], None, at)

    def presets(self) -> Mapping[str, str]:
        root = parsed_xml(self._connection.ask(f"{self._base}/presets").body)
        known = {}
        for element in root.iter():
            if local(element) == "PTZPreset":
                token, name = found(element, "id"), found(element, "presetName")
                enabled = found(element, "enabled")
                if token is not None and token.text and (enabled is None or enabled.text == "true"):
                    known[(name.text if name is not None else None) or token.text] = token.text
        return known

    def go_to(self, preset: str) -> None:
        self._connection.ask(f"{self._base}/presets/{token_of(self.presets(), preset)}/goto", "PUT")

    def close(self) -> None:
        self._connection.close()


_PAGE = "/axis-cgi/com/ptz.cgi"
_PRESET = re.compile(r"presetposno(\d+)")


class VapixPtzHead:
    """Degrees: pan clockwise, tilt upwards. It reports neither the time of a reading nor motion."""

    def __init__(self, config: VapixConfig, source: SourceConfig | None, connection: Connection | None = None) -> None:
        self._connection = connection or Connection(settings_of(config, source))
        self._camera = f"&camera={config.camera}"
        self.spacing = spacing_for(tolerance_of(config).angle_deg)

    def read(self) -> PtzReading:
        said = self._lines("query=position")
        pan, tilt = (number(said.get(axis), axis) for axis in ("pan", "tilt"))
        return PtzReading(pan, tilt, number(said.get("zoom", "1"), "zoom"), None, time.monotonic())

    def presets(self) -> Mapping[str, str]:
        found = {}
        for name, value in self._lines("query=presetposall").items():
            match = _PRESET.fullmatch(name)
            if match is not None:
                found[value] = match[1]
        return found

    def go_to(self, preset: str) -> None:
        token_of(self.presets(), preset)  # for an unknown name, it answers nothing
        self._ask(f"gotoserverpresetname={quote(preset)}", accepted=(200, 204))

    def close(self) -> None:
        self._connection.close()

    def _ask(self, query: str, accepted: tuple[int, ...] = (200,)) -> str:
        body = self._connection.ask(f"{_PAGE}?{query}{self._camera}", accepted=accepted).body
        text = body.decode("utf-8", "replace")
        if text.lstrip().lower().startswith("error"):
            raise SourceError(f"the PTZ head answered {text.strip()[:80]!r} to {query.partition('=')[2]}")
        return text

    def _lines(self, query: str) -> dict[str, str]:
        lines = (line.partition("=") for line in self._ask(query).splitlines())
        said = {name.strip(): value.strip() for name, sign, value in lines if sign}
        if not said and query != "query=presetposall":
            raise SourceError("the camera reports no position by VAPIX: it has no PTZ head, or uses another protocol")
        return said


def open_ptz(config: PtzConfig, source: SourceConfig | None, connection: Connection | None = None) -> PtzHead:
    """Open a PTZ head without a request. `connection`: an existing one. Raises SourceError, and UnauthorisedError if
    the password cannot be read."""
    match config:
        case VapixConfig():
            return VapixPtzHead(config, source, connection)
        case IsapiConfig():
            return IsapiPtzHead(config, source, connection)
        case OnvifConfig():
            return OnvifPtzHead(config, source, connection)
