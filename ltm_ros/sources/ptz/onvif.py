"""Heads by ONVIF: position of the generic space (-1 to 1), or in degrees where the head has that space. Source: ONVIF
PTZ Service Specification."""

from __future__ import annotations

import time
import xml.etree.ElementTree as ElementTree  # nosec B405 # parsed by `parsed_xml`
from collections.abc import Mapping

from ltm_core.ptz_config import OnvifConfig
from ltm_core.source_config import SourceConfig
from ltm_ros.sources.direction import Reading
from ltm_ros.sources.errors import SourceError
from ltm_ros.sources.ptz.connection import Connection, at_asked_host, found, local, number, settings_of
from ltm_ros.sources.ptz.head import Limits, spacing_for, token_of, tolerance_of
from ltm_ros.sources.ptz.soap import DEVICE, MEDIA, PTZ, STREAM_SETUP, SoapClient

_DEGREES = "SphericalPositionSpaceDegrees"


class OnvifHead:
    """Whether its axes run clockwise and upwards differs from maker to maker, and from its own velocities: the mount's
    signs are calibrated (`ltm pose`), not believed. MoveStatus is often missing or never changes, so that it is only
    believed where it says that the head moves."""

    def __init__(self, config: OnvifConfig, source: SourceConfig | None, connection: Connection | None = None) -> None:
        self._config = config
        self._connection = connection or Connection(settings_of(config, source))
        self._device = self._connection.settings.url + config.path
        self.soap = SoapClient(self._connection, self._device)
        self.spacing = spacing_for(tolerance_of(config).angle_deg)
        self._addresses: tuple[str, str] | None = None
        self._profile = config.profile

    def read(self) -> Reading:
        root = self._ask("GetStatus")
        at = time.monotonic()
        turn, zoom = found(root, "Position", "PanTilt"), found(root, "Position", "Zoom")
        if turn is None:
            raise SourceError("the head tells no position by ONVIF (GetStatus without PanTilt): it cannot be used")
        x, y = number(turn.get("x"), "pan"), number(turn.get("y"), "tilt")
        if _DEGREES not in (turn.get("space") or ""):
            x, y = _scaled(x, self._config.pan_range_deg), _scaled(y, self._config.tilt_range_deg)
        status = found(root, "MoveStatus", "PanTilt")
        moving = True if status is not None and (status.text or "").strip() == "MOVING" else None
        return Reading(x, y, 0.0 if zoom is None else number(zoom.get("x"), "zoom"), moving, at)

    def limits(self) -> Limits:
        root = self._ask("GetNodes", with_profile=False)

        def both(space: str, axis: str, scale: tuple[float, float] | None) -> tuple[float, float] | None:
            place = found(root, space, axis)
            ends = None if place is None else (found(place, "Min"), found(place, "Max"))
            if ends is None or ends[0] is None or ends[1] is None:
                return None
            low, high = number(ends[0].text, axis), number(ends[1].text, axis)
            return (low, high) if scale is None else (_scaled(low, scale), _scaled(high, scale))

        turn = "AbsolutePanTiltPositionSpace"
        pan = both(turn, "XRange", self._config.pan_range_deg)
        tilt = both(turn, "YRange", self._config.tilt_range_deg)
        return Limits(pan, tilt, both("AbsoluteZoomPositionSpace", "XRange", None))

    def presets(self) -> Mapping[str, str]:
        known = {}
        for element in self._ask("GetPresets").iter():
            if local(element) == "Preset" and (token := element.get("token")):
                name = found(element, "Name")
                known[(name.text if name is not None else None) or token] = token
        return known

    def go_to(self, preset: str) -> None:
        self._ask("GotoPreset", {"PresetToken": token_of(self.presets(), preset)})

    def picture_addresses(self) -> tuple[str | None, str | None]:
        """URLs of a snapshot and of a stream, as the camera states them."""
        media, _ = self._services()
        token = {"ProfileToken": self._token()}
        found_at: list[str | None] = []
        for name, setup in (("GetSnapshotUri", ""), ("GetStreamUri", STREAM_SETUP)):
            try:
                place = found(self.soap.call(media, MEDIA, name, token, setup), "Uri")
            except SourceError:
                place = None
            found_at.append(None if place is None else place.text)
        return found_at[0], found_at[1]

    def close(self) -> None:
        self._connection.close()

    def _ask(
        self, name: str, arguments: Mapping[str, str] | None = None, with_profile: bool = True
    ) -> ElementTree.Element:
        _, address = self._services()
        whole = {"ProfileToken": self._token()} if with_profile else {}
        return self.soap.call(address, PTZ, name, {**whole, **(arguments or {})})

    def _services(self) -> tuple[str, str]:
        """Addresses of media and PTZ, at the host that was asked."""
        if self._addresses is None:
            root = self.soap.call(self._device, DEVICE, "GetCapabilities", {"Category": "All"})
            places = []
            for name in ("Media", "PTZ"):
                address = found(root, name, "XAddr")
                if address is None or not address.text:
                    what = "no head" if name == "PTZ" else "no pictures"
                    raise SourceError(f"the camera has {what} by ONVIF (no service {name})")
                places.append(at_asked_host(address.text, self._connection.settings.url))
            self._addresses = places[0], places[1]
        return self._addresses

    def _token(self) -> str:
        if self._profile is None:
            media, _ = self._services()
            root = self.soap.call(media, MEDIA, "GetProfiles")
            profiles = [e for e in root.iter() if local(e) == "Profiles" and e.get("token")]
            with_head = [e for e in profiles if found(e, "PTZConfiguration") is not None]
            if not with_head:
                raise SourceError("none of the camera's media profiles has a head: choose one in the camera's settings")
            self._profile = with_head[0].get("token") or ""
        return self._profile


def _scaled(value: float, ends: tuple[float, float]) -> float:
    """From -1 to 1 to between two ends."""
    return ends[0] + (value + 1) / 2 * (ends[1] - ends[0])
