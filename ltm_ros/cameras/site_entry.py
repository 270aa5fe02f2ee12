"""The section of a camera in a site file, from what a probe has found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ltm_core.site.source_config import SecretConfig
from ltm_ros.cameras.probe import Found

SNAPSHOT_EVERY_S = 10.0


@dataclass(frozen=True)
class Placing:
    """What a camera cannot say of itself."""

    lon: float | None = None
    lat: float | None = None
    height_above_ground: float | None = None
    azimuth_deg: float | None = None
    pitch_deg: float = 0.0
    hfov_deg: float | None = None


def site_entry(found: Found, user: str | None, password: SecretConfig | None, placing: Placing) -> dict[str, Any]:
    """Sections source, ptz, mount or pose, calibration, as far as they are known."""
    entry: dict[str, Any] = {}
    if found.source is not None:
        entry["source"] = dict(found.source)
        if found.source["kind"] == "snapshot":
            entry["source"]["every"] = SNAPSHOT_EVERY_S
        if user is not None:
            entry["source"]["user"] = user
        if password is not None:
            place = password.model_dump(exclude_none=True)
            entry["source"]["password"] = {key: str(value) for key, value in place.items()}
    where: dict[str, Any] = {}
    if placing.lon is not None and placing.height_above_ground is not None and placing.azimuth_deg is not None:
        where = {
            "lon": placing.lon,
            "lat": placing.lat,
            "height_above_ground": placing.height_above_ground,
            "azimuth_deg": placing.azimuth_deg,
        }
    if found.ptz is not None:
        entry["ptz"] = dict(found.ptz.config)
    if found.ptz is not None and found.size is not None:
        mount: dict[str, Any] = dict(where)
        if found.ptz.config["kind"] == "isapi":
            mount["tilt_sign"] = -1
        width, height = found.size
        if found.ptz.config["kind"] == "vapix" and placing.hfov_deg is None:
            # The table is that of ALERTCalifornia's Axis cameras, until it is calibrated.
            mount["lens"] = {"width": width, "height": height}
        elif placing.hfov_deg is not None:
            entry["calibration"] = {"width": width, "height": height, "hfov_deg": placing.hfov_deg}
        entry["mount"] = mount
    elif where:
        entry["pose"] = where | {"pitch_deg": placing.pitch_deg}
    if found.ptz is None and found.size is not None and placing.hfov_deg is not None:
        entry["calibration"] = {"width": found.size[0], "height": found.size[1], "hfov_deg": placing.hfov_deg}
    return entry


def lacking(entry: dict[str, Any]) -> list[str]:
    """What a person must add before the camera can be used, with the option of `ltm cameras probe` for it."""
    said = []
    if "source" not in entry:
        said.append("source: no picture was found; give the address of one")
    if "azimuth_deg" not in (entry.get("mount") or entry.get("pose") or {}):
        which = "mount" if "ptz" in entry else "pose"
        said.append(f"{which}: where it stands and looks (--lonlat, --height, --azimuth)")
    if "calibration" not in entry and "lens" not in entry.get("mount", {}):
        said.append("calibration: the horizontal field of view, of the data sheet or measured (--hfov)")
    return said
