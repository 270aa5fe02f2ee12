"""Query Hikvision heads by ISAPI and Axis heads by VAPIX.

Hikvision PTZ heads by ISAPI. Source: ISAPI 2.0, PTZCtrl; fields as cameras send them.

Units differ from page to page: tenths of a degree in `status`, degrees with decimals in `absoluteEx`.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from urllib.parse import quote

from ltm_core.site.ptz_config import IsapiConfig, VapixConfig
from ltm_core.site.source_config import SourceConfig
from ltm_ros.cameras.protocols.direction import PtzReading
from ltm_ros.cameras.protocols.errors import SourceError
from ltm_ros.cameras.ptz.connection import Connection, found, local, number, parsed_xml, settings_of
from ltm_ros.cameras.ptz.head import PtzLimits, spacing_for, token_of, tolerance_of


class IsapiPtzHead:
    """Azimuth is its pan, elevation its tilt. Elevation grows downwards on most of these PTZ heads (0 level, 90
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
                raise SourceError(f"the PTZ head's page {page} holds no {name}: write the other units as ptz.units")
            values.append(number(element.text, name))
        scale = 0.1 if self._tenths else 1.0
        return PtzReading(values[0] * scale, values[1] * scale, values[2], None, at)

    def limits(self) -> PtzLimits:
        """In the units of `status`, whatever the readings are in: so cameras state them."""
        root = parsed_xml(self._connection.ask(f"{self._base}/capabilities").body)

        def both(scale: float, *names: str) -> tuple[float, float] | None:
            place = found(root, *names)
            ends = None if place is None else (found(place, "Min"), found(place, "Max"))
            if ends is None or ends[0] is None or ends[1] is None:
                return None
            return number(ends[0].text, names[-1]) * scale, number(ends[1].text, names[-1]) * scale

        space = "AbsolutePanTiltPositionSpace"
        zoom = both(1.0 if self._tenths else 0.1, "AbsoluteZoomPositionSpace", "ZRange")
        return PtzLimits(both(0.1, space, "XRange"), both(0.1, space, "YRange"), zoom)

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
    """Degrees: pan clockwise, tilt upwards. It says neither when it read them nor whether it moves."""

    def __init__(self, config: VapixConfig, source: SourceConfig | None, connection: Connection | None = None) -> None:
        self._connection = connection or Connection(settings_of(config, source))
        self._camera = f"&camera={config.camera}"
        self.spacing = spacing_for(tolerance_of(config).angle_deg)

    def read(self) -> PtzReading:
        said = self._lines("query=position")
        pan, tilt = (number(said.get(axis), axis) for axis in ("pan", "tilt"))
        return PtzReading(pan, tilt, number(said.get("zoom", "1"), "zoom"), None, time.monotonic())

    def limits(self) -> PtzLimits:
        said = {name.lower(): value for name, value in self._lines("query=limits").items()}

        def both(axis: str) -> tuple[float, float] | None:
            ends = said.get(f"min{axis}"), said.get(f"max{axis}")
            return None if None in ends else (number(ends[0], axis), number(ends[1], axis))

        return PtzLimits(both("pan"), both("tilt"), both("zoom"))

    def presets(self) -> Mapping[str, str]:
        found = {}
        for name, value in self._lines("query=presetposall").items():
            match = _PRESET.fullmatch(name)
            if match is not None:
                found[value] = match[1]
        return found

    def go_to(self, preset: str) -> None:
        token_of(self.presets(), preset)  # where it has none of that name, it says nothing
        self._ask(f"gotoserverpresetname={quote(preset)}", accepted=(200, 204))

    def close(self) -> None:
        self._connection.close()

    def _ask(self, query: str, accepted: tuple[int, ...] = (200,)) -> str:
        body = self._connection.ask(f"{_PAGE}?{query}{self._camera}", accepted=accepted).body
        text = body.decode("utf-8", "replace")
        if text.lstrip().lower().startswith("error"):
            raise SourceError(f"the PTZ head answers {text.strip()[:80]!r} to {query.partition('=')[2]}")
        return text

    def _lines(self, query: str) -> dict[str, str]:
        lines = (line.partition("=") for line in self._ask(query).splitlines())
        said = {name.strip(): value.strip() for name, sign, value in lines if sign}
        if not said and query != "query=presetposall":
            raise SourceError("the camera tells no position by VAPIX: it has no PTZ head, or speaks something else")
        return said
