"""Axis heads by VAPIX: `ptz.cgi` in lines of `name=value`. Source: VAPIX Network Video API, PTZ."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from urllib.parse import quote

from ltm_core.ptz_config import VapixConfig
from ltm_core.source_config import SourceConfig
from ltm_ros.sources.direction import Reading
from ltm_ros.sources.errors import SourceError
from ltm_ros.sources.ptz.connection import Connection, number, settings_of
from ltm_ros.sources.ptz.head import Limits, spacing_for, token_of, tolerance_of

_PAGE = "/axis-cgi/com/ptz.cgi"
_PRESET = re.compile(r"presetposno(\d+)")


class VapixHead:
    """Degrees: pan clockwise, tilt upwards. It says neither when it read them nor whether it moves."""

    def __init__(self, config: VapixConfig, source: SourceConfig | None, connection: Connection | None = None) -> None:
        self._connection = connection or Connection(settings_of(config, source))
        self._camera = f"&camera={config.camera}"
        self.spacing = spacing_for(tolerance_of(config).angle_deg)

    def read(self) -> Reading:
        said = self._lines("query=position")
        pan, tilt = (number(said.get(axis), axis) for axis in ("pan", "tilt"))
        return Reading(pan, tilt, number(said.get("zoom", "1"), "zoom"), None, time.monotonic())

    def limits(self) -> Limits:
        said = {name.lower(): value for name, value in self._lines("query=limits").items()}

        def both(axis: str) -> tuple[float, float] | None:
            ends = said.get(f"min{axis}"), said.get(f"max{axis}")
            return None if None in ends else (number(ends[0], axis), number(ends[1], axis))

        return Limits(both("pan"), both("tilt"), both("zoom"))

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
            raise SourceError(f"the head answers {text.strip()[:80]!r} to {query.partition('=')[2]}")
        return text

    def _lines(self, query: str) -> dict[str, str]:
        lines = (line.partition("=") for line in self._ask(query).splitlines())
        said = {name.strip(): value.strip() for name, sign, value in lines if sign}
        if not said and query != "query=presetposall":
            raise SourceError("the camera tells no position by VAPIX: it has no head, or speaks something else")
        return said
