"""Read DJI metadata: XMP in photos.

Gimbal angles are of the camera: yaw clockwise from true north, pitch up from the horizon, roll clockwise.
`AbsoluteAltitude` is above sea level (above the ellipsoid with RTK), `RelativeAltitude` above the take-off place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ltm_ros.recordings.importing.exif import number
from ltm_ros.recordings.importing.sensor_track import Sensed

SOURCE = "DJI"
_GIMBAL_SIGMA_DEG = 0.5
"""Standard deviation of a gimbal's pitch and roll in degrees."""


def sensed_by_xmp(xmp: Mapping[str, str], by_exif: Sensed) -> Sensed:
    """Return the sensor data of a photo's XMP (`xmp_values`) over its EXIF; unchanged if it is not from DJI."""
    found = {key.removeprefix("drone-dji:"): value for key, value in xmp.items() if key.startswith("drone-dji:")}
    angles = [number(found.get(f"Gimbal{axis}Degree")) for axis in ("Yaw", "Pitch", "Roll")]
    if all(angle is None for angle in angles):
        return by_exif
    yaw, pitch, roll = angles
    facts: dict[str, Any] = {
        "source": SOURCE,
        "in_flight": True,
        "pitch_deg": pitch,
        "roll_deg": roll,
        "tilt_sigma_deg": _GIMBAL_SIGMA_DEG,
    }
    if yaw is not None:
        facts |= {"azimuth_deg": yaw % 360.0, "azimuth_ref": "T"}
    lat, lon = number(found.get("GpsLatitude")), number(found.get("GpsLongitude", found.get("GpsLongtitude")))
    if lat is not None and lon is not None and abs(lat) <= 90 and abs(lon) <= 180 and (lat, lon) != (0.0, 0.0):
        facts |= {"lat": lat, "lon": lon}
    deviations = [number(found.get(f"RtkStd{axis}")) for axis in ("Lon", "Lat", "Hgt")]
    if deviations[0] and deviations[1] and deviations[0] > 0 and deviations[1] > 0:
        facts["position_sigma"] = math.hypot(deviations[0], deviations[1]) / math.sqrt(2)
        facts["altitude_sigma"] = deviations[2] if deviations[2] and deviations[2] > 0 else None
    altitude = number(found.get("AbsoluteAltitude"))
    if altitude is not None:
        facts |= {"altitude": altitude, "ellipsoidal": "rtk" in found.get("AltitudeType", "").lower() or None}
    climb = number(found.get("RelativeAltitude"))
    if climb is not None:
        facts["climb"] = climb
    return replace(by_exif, **facts)
