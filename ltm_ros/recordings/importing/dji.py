"""Read DJI metadata: XMP in photos, subtitles (SRT) beside videos.

Gimbal angles are of the camera: yaw clockwise from true north, pitch up from the horizon, roll clockwise. Altitudes:
`AbsoluteAltitude`, `abs_alt` above sea level (above the ellipsoid with RTK), `RelativeAltitude`, `rel_alt` above the
take-off place.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float64Array, Int64Array
from ltm_core.cameras.camera_config import PartialCalibration
from ltm_core.geometry.pose import Pose
from ltm_core.storage.text_io import read_text
from ltm_ros.recordings.importing.sensor_track import Attitudes, Climb, Fixes, Sensed, SensorTrack, ascending

SOURCE = "DJI"
_LARGEST_SRT = 64 << 20
_ATTRIBUTE = re.compile(r"drone-dji:(\w+)\s*(?:=\s*\"([^\"]*)\"|>([^<]*)<)")
_GIMBAL_SIGMA_DEG = 0.5
"""Standard deviation of a gimbal's pitch and roll in degrees."""
_BLOCK = re.compile(r"\b(\d{1,3}):(\d{2}):(\d{2})[,.](\d{3})\s*-->")
_FIELD = re.compile(
    r"\b(latitude|longt?itude|rel_alt|abs_alt|altitude|gb_yaw|gb_pitch|gb_roll|focal_len|dzoom_ratio)\s*:\s*([+-]?\d+(?:\.\d+)?)"
)
_GPS = re.compile(r"GPS\s*\(\s*([+-]?\d+\.\d+)\s*,\s*([+-]?\d+\.\d+)\s*,")
_BAROMETER = re.compile(r"BAROMETER\s*[:(]\s*([+-]?\d+(?:\.\d+)?)")
_DATE = re.compile(r"(\d{4})[-.](\d{2})[-.](\d{2}) (\d{2}):(\d{2}):(\d{2})(?:[.,](\d{3}))?")


def sensed_by_xmp(xmp: bytes | str | None, by_exif: Sensed, width: int, height: int) -> Sensed:
    """Return the sensor data of a photo's XMP packet in addition to its EXIF; unchanged if the packet is not from DJI.
    `width`, `height`: of the upright image.
    """
    text = xmp.decode("utf-8", "replace") if isinstance(xmp, bytes) else xmp or ""
    found: dict[str, str] = {}
    for key, value, content in _ATTRIBUTE.findall(text):  # a closing tag comes after, without a value
        found.setdefault(key, value or content)
    angles = [_number(found.get(f"Gimbal{axis}Degree")) for axis in ("Yaw", "Pitch", "Roll")]
    if not found or all(angle is None for angle in angles):
        return by_exif
    yaw, pitch, roll = angles
    facts: dict[str, Any] = {
        "source": SOURCE,
        "pitch_deg": pitch,
        "roll_deg": roll,
        "tilt_sigma_deg": _GIMBAL_SIGMA_DEG,
    }
    if yaw is not None:
        facts |= {"azimuth_deg": yaw % 360.0, "azimuth_ref": "T"}
    lat, lon = _number(found.get("GpsLatitude")), _number(found.get("GpsLongitude", found.get("GpsLongtitude")))
    if lat is not None and lon is not None and abs(lat) <= 90 and abs(lon) <= 180 and (lat, lon) != (0.0, 0.0):
        facts |= {"lat": lat, "lon": lon}
    deviations = [_number(found.get(f"RtkStd{axis}")) for axis in ("Lon", "Lat", "Hgt")]
    if deviations[0] and deviations[1] and deviations[0] > 0 and deviations[1] > 0:
        facts["position_sigma"] = math.hypot(deviations[0], deviations[1]) / math.sqrt(2)
        facts["altitude_sigma"] = deviations[2] if deviations[2] and deviations[2] > 0 else None
    altitude = _number(found.get("AbsoluteAltitude"))
    if altitude is not None:
        facts |= {"altitude": altitude, "ellipsoidal": "rtk" in found.get("AltitudeType", "").lower()}
    climb = _number(found.get("RelativeAltitude"))
    if climb is not None:
        facts["climb"] = climb
    focal = _number(found.get("CalibratedFocalLength"))
    if focal is not None and 0.3 < focal / max(width, height) < 20:  # some models use millimetres
        centre = [_number(found.get(f"CalibratedOpticalCenter{axis}")) for axis in "XY"]
        inside = all(
            c is not None and abs(c / side - 0.5) < 0.1 for c, side in zip(centre, (width, height), strict=True)
        )
        cx, cy = centre if inside else (None, None)
        facts["calibration"] = PartialCalibration(fx=focal, cx=cx, cy=cy)
    return replace(by_exif, **facts)


def subtitles_of(video: Path) -> Path | None:
    """Return the subtitles beside a video: its name with .SRT."""
    return next((p for suffix in (".SRT", ".srt") if (p := video.with_suffix(suffix)).is_file()), None)


def read_subtitles(path: Path, zone: tzinfo | None) -> tuple[SensorTrack, datetime | None, float | None]:
    """Return the flight, with stamps that count from 1 at the video's start; the start time; the focal length in 35 mm
    equivalent. `zone`: of the dates, which state none; None: UTC.

    Raises RecordingError for a file that is not text, or has no position.
    """
    text = read_text(path, _LARGEST_SRT, RecordingError, "utf-8-sig")
    marks = list(_BLOCK.finditer(text))
    rows: list[dict[str, float]] = []
    begin: datetime | None = None
    for number, mark in enumerate(marks, start=1):
        block = text[mark.end() : marks[number].start() if number < len(marks) else len(text)]
        hours, minutes, seconds, milli = (int(v) for v in mark.groups())
        at = hours * 3600 + minutes * 60 + seconds + milli / 1000
        row = _fields(block)
        if begin is None:
            begin = _date(block, at, zone)
        if "lat" in row:
            rows.append(row | {"at": at})
    if not rows:
        raise RecordingError(
            f"{path}: no position in its {len(marks)} blocks: enable `Video Captions` in the drone's app, or give "
            "the frames' positions in a pose file (--poses)"
        )
    stamps = 1 + np.array([round(row["at"] * 1000) * 1_000_000 for row in rows], np.int64)
    order = ascending(stamps)
    columns = {
        name: np.array([row.get(name, math.nan) for row in rows])[order]
        for name in ("lat", "lon", "abs_alt", "rel_alt", "gb_yaw", "gb_pitch", "gb_roll")
    }
    unknown = np.full(len(order), np.nan)
    fixes = Fixes(stamps[order], columns["lon"], columns["lat"], columns["abs_alt"], unknown, unknown)
    climbed = np.isfinite(columns["rel_alt"])
    climb = Climb(stamps[order][climbed], columns["rel_alt"][climbed]) if climbed.any() else None
    focal = next((row["focal"] for row in rows if "focal" in row), None)
    return SensorTrack(SOURCE, fixes, _gimbal(stamps[order], columns), climb), begin, focal


def _fields(block: str) -> dict[str, float]:
    found = {key.replace("longtitude", "longitude"): float(value) for key, value in _FIELD.findall(block)}
    row = {key: found[key] for key in ("rel_alt", "abs_alt", "gb_yaw", "gb_pitch", "gb_roll") if key in found}
    if "altitude" in found:
        row.setdefault("abs_alt", found["altitude"])
    lat, lon = found.get("latitude"), found.get("longitude")
    old = _GPS.search(block)
    if lat is None and old is not None:  # longitude first, as Phantoms write it
        lon, lat = float(old[1]), float(old[2])
        barometer = _BAROMETER.search(block)
        if barometer is not None:
            row["rel_alt"] = float(barometer[1])
    if lat is not None and lon is not None and abs(lat) <= 90 and abs(lon) <= 180 and (lat, lon) != (0.0, 0.0):
        row |= {"lat": lat, "lon": lon}
    focal = found.get("focal_len")
    if focal is not None and focal > 0:
        # Older firmware writes tenths of a millimetre without a point.
        row["focal"] = focal / 10 if focal >= 150 else focal
        zoom = found.get("dzoom_ratio", 1.0)
        row["focal"] *= zoom if 1.0 <= zoom <= 30.0 else 1.0
    return row


def _gimbal(stamps: Int64Array, columns: dict[str, Float64Array]) -> Attitudes | None:
    known = np.isfinite(columns["gb_yaw"]) & np.isfinite(columns["gb_pitch"])
    if not known.any():
        return None
    angles = np.column_stack([columns["gb_yaw"], columns["gb_pitch"], np.nan_to_num(columns["gb_roll"])])[known]
    matrices = [Pose.from_angles((0.0, 0.0, 0.0), *row).rotation for row in angles]
    return Attitudes(stamps[known], Rotation.from_matrix(np.array(matrices)), "T", None, _GIMBAL_SIGMA_DEG)


def _date(block: str, at: float, zone: tzinfo | None) -> datetime | None:
    """Return the start time of the video, from a block with a date."""
    found = _DATE.search(block)
    if found is None:
        return None
    *parts, milli = found.groups()
    try:
        there = datetime(*map(int, parts), int(milli or 0) * 1000, tzinfo=zone or UTC)  # type: ignore[misc,arg-type]
        return there - timedelta(seconds=at)
    except (ValueError, OverflowError):
        return None


def _number(text: str | None) -> float | None:
    try:
        number = float(text or "")
    except ValueError:
        return None
    return number if math.isfinite(number) else None
