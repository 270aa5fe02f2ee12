"""Reolink PTZ heads by the cameras' HTTP API (JSON). Source: Reolink, Camera HTTP API User Guide, version 8; names of
the position's fields from reolink-aio 0.22.

Own code: reolink-aio is asynchronous and asks a camera for all it has before it tells a position; that needs two calls.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any

from ltm_core.site.ptz_config import ReolinkConfig
from ltm_core.site.source_config import HttpSettings, SourceConfig
from ltm_ros.cameras.protocols.credentials import Login
from ltm_ros.cameras.protocols.direction import PtzReading
from ltm_ros.cameras.protocols.errors import SourceError, UnauthorisedError
from ltm_ros.cameras.ptz.connection import Connection, number, settings_of
from ltm_ros.cameras.ptz.head import PtzLimits, spacing_for, token_of, tolerance_of

_PAGE = "/cgi-bin/api.cgi"
_LOGIN_AGAIN = -6
"""Code of an answer to a token that has run out."""
_BEFORE_END_S = 60.0


class ReolinkPtzHead:
    """Pan and tilt in the camera's own counts, which are divided by the steps a degree of the site file."""

    def __init__(
        self, config: ReolinkConfig, source: SourceConfig | None, connection: Connection | None = None
    ) -> None:
        settings = settings_of(config, source)
        self._login = Login.of(settings)
        # User and password go into the log-in's body, not into each request.
        self._connection = connection or Connection(
            HttpSettings(url=settings.url, timeout=settings.timeout, ca=settings.ca, check_name=settings.check_name)
        )
        self._config = config
        self._token, self._token_until = "", 0.0
        self.spacing = spacing_for(tolerance_of(config).angle_deg)

    def read(self) -> PtzReading:
        channel = self._config.channel
        said = _part(self._ask("GetPtzCurPos", {"PtzCurPos": {"channel": channel}}), "PtzCurPos")
        at = time.monotonic()
        focus = _part(self._ask("GetZoomFocus", {"channel": channel}), "ZoomFocus")
        zoom = _part(focus, "zoom").get("pos", 0)
        pan, tilt = (number(str(said.get(key)), key) for key in ("Ppos", "Tpos"))
        return PtzReading(
            pan / self._config.pan_steps_per_deg,
            tilt / self._config.tilt_steps_per_deg,
            number(str(zoom), "zoom"),
            None,
            at,
        )

    def limits(self) -> PtzLimits:
        return PtzLimits()

    def presets(self) -> Mapping[str, str]:
        said = self._ask("GetPtzPreset", {"channel": self._config.channel}).get("PtzPreset") or []
        if not isinstance(said, list):
            raise SourceError("the camera tells its presets in no form that is known")
        rows = [row for row in said if isinstance(row, dict) and row.get("enable", 1) == 1 and "id" in row]
        return {str(row.get("name") or row["id"]): str(row["id"]) for row in rows}

    def go_to(self, preset: str) -> None:
        number = int(token_of(self.presets(), preset))
        where = {"channel": self._config.channel, "op": "ToPos", "speed": 32, "id": number}
        self._ask("PtzCtrl", where)

    def close(self) -> None:
        self._connection.close()

    def _ask(self, command: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
        if time.monotonic() > self._token_until:
            self._log_in()
        code, value = self._send(command, parameters, f"&token={self._token}")
        if code == _LOGIN_AGAIN:
            self._log_in()
            code, value = self._send(command, parameters, f"&token={self._token}")
        if code:
            raise SourceError(
                f"the camera refuses {command} (code {code}): it may have no PTZ head, or the user no right"
            )
        return value

    def _log_in(self) -> None:
        password = self._login.password.reveal() if self._login.password is not None else ""
        user = {"User": {"userName": self._login.user or "", "password": password}}
        code, value = self._send("Login", user, "")
        token = _part(value, "Token")
        if code or not token.get("name"):
            raise UnauthorisedError(f"the camera refuses the user {self._login.user} (code {code}): mend the password")
        self._token = str(token["name"])
        lease = number(str(token.get("leaseTime", 3600)), "leaseTime")
        self._token_until = time.monotonic() + max(lease - _BEFORE_END_S, 1.0)

    def _send(self, command: str, parameters: Mapping[str, Any], token: str) -> tuple[int, dict[str, Any]]:
        body = json.dumps([{"cmd": command, "action": 0, "param": parameters}]).encode()
        kind = {"content-type": "application/json"}
        answer = self._connection.ask(f"{_PAGE}?cmd={command}{token}", "POST", body, kind)
        try:
            (said,) = json.loads(answer.body)
            code = int(said.get("code", 0))
            if code:
                code = int((said.get("error") or {}).get("rspCode", code))
            value = said.get("value") or {}
        except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
            raise SourceError("the camera answers no JSON of Reolink's: check url and kind of ptz") from None
        if not isinstance(value, dict):
            raise SourceError(f"the camera answers {command} in no form that is known")
        return code, value


def _part(answer: Mapping[str, Any], key: str) -> dict[str, Any]:
    """What an answer holds by that name, nothing where it has none. Raises SourceError where it is no such thing."""
    part = answer.get(key) or {}
    if not isinstance(part, dict):
        raise SourceError(f"the camera answers {key} in no form that is known ({str(part)[:80]!r})")
    return part
