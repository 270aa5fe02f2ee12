"""Read DJI metadata: XMP in photos, subtitles (SRT) beside videos.

Gimbal angles are of the camera: yaw clockwise from true north, pitch up from the horizon, roll clockwise. Altitudes:
`AbsoluteAltitude`, `abs_alt` above sea level (above the ellipsoid with RTK); `RelativeAltitude`, `rel_alt`, `H` and
`BAROMETER` above the take-off place. `altitude` is above either, so that it counts only with the take-off's height."""

from __future__ import annotations

import bisect
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float64Array, Int64Array
from ltm_core.geometry.pose import Pose
from ltm_core.storage.config_io import read_text
from ltm_ros.recordings.importing.exif import number
from ltm_ros.recordings.importing.intrinsics import LensFacts, lens_of_subtitle
from ltm_ros.recordings.importing.sensor_track import Attitudes, Climb, Fixes, Sensed, SensorTrack, ascending

SOURCE = "DJI"
_LARGEST_SRT = 64 << 20
_GIMBAL_SIGMA_DEG = 0.5
"""Standard deviation of a gimbal's pitch and roll in degrees."""
_METRES = {"m": 1.0, "ft": 0.3048, "": 1.0}
_NUMBER = r"([+-]?\d+(?:[.,]\d+)?)"
_BLOCK = re.compile(r"\b(\d{1,3}):(\d{2}):(\d{2})[,.](\d{3})\s*-->")
_FIELD = re.compile(r"\b(latitude|longt?itude|rel_alt|abs_alt|altitude|gb_yaw|gb_pitch|gb_roll)\s*:\s*" + _NUMBER)
_GPS = re.compile(r"GPS\s*\(\s*([+-]?\d+(?:\.\d+)?)\s*,\s*([+-]?\d+(?:\.\d+)?)\s*(?:,\s*([^)]*))?\)")
_CLIMB = re.compile(rf"\b(?:BAROMETER\s*[:(]|Hb\s*:|H\s)\s*{_NUMBER}\s*(m|ft)?\b", re.IGNORECASE)
_DATE = re.compile(r"(\d{4})[-.](\d{1,2})[-.](\d{1,2}) (\d{2}):(\d{2}):(\d{2})(?:[.,](\d{3}))?")


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
    if lat is not None and lon is not None and _on_globe(lat, lon):
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


@dataclass(frozen=True, eq=False)
class Flight:
    """Subtitles of a video. `track`: with stamps that count from 1 at the video's start. `begins`: its time by the
    drone's clock, without a zone. `lenses`: by seconds, ascending."""

    track: SensorTrack
    begins: datetime | None
    lenses: list[tuple[float, LensFacts]]

    def lens_at(self, seconds: float) -> LensFacts | None:
        after = bisect.bisect_right(self.lenses, seconds + 1e-3, key=lambda item: item[0])
        return self.lenses[max(after - 1, 0)][1] if self.lenses else None


def subtitles_of(video: Path) -> Path | None:
    """Return the subtitles beside a video: its name with .SRT."""
    return next((p for suffix in (".SRT", ".srt") if (p := video.with_suffix(suffix)).is_file()), None)


def read_subtitles(path: Path, covers: Callable[[float, float], bool] | None = None) -> Flight:
    """Read a flight. `covers(lon, lat)`: whether the site has terrain there, which decides the order of coordinates.

    Raises RecordingError for a file that is not text, has no position, or has positions of an unknown order."""
    text = read_text(path, _LARGEST_SRT, RecordingError, "utf-8-sig")
    marks = list(_BLOCK.finditer(text))
    rows: list[dict[str, float]] = []
    lenses: list[tuple[float, LensFacts]] = []
    begins: datetime | None = None
    lon_first: bool | None = None
    for k, mark in enumerate(marks, start=1):
        block = text[mark.end() : marks[k].start() if k < len(marks) else len(text)]
        hours, minutes, seconds, milli = (int(v) for v in mark.groups())
        at = hours * 3600 + minutes * 60 + seconds + milli / 1000
        begins = begins or _date(block, at)
        lens = lens_of_subtitle(block)
        if lens is not None and (not lenses or lens != lenses[-1][1]):
            lenses.append((at, lens))
        row, pair = _fields(block), _GPS.search(block)
        if "lat" not in row and pair is not None:
            a, b = float(pair[1]), float(pair[2])
            if lon_first is None and (a, b) != (0.0, 0.0):
                lon_first = _lon_first(a, b, (pair[3] or "").strip(), covers, path)
            lat, lon = (b, a) if lon_first else (a, b)
            if _on_globe(lat, lon):
                row |= {"lat": lat, "lon": lon}
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
    return Flight(SensorTrack(SOURCE, fixes, _gimbal(stamps[order], columns), climb), begins, lenses)


def _lon_first(a: float, b: float, third: str, covers: Callable[[float, float], bool] | None, path: Path) -> bool:
    """Return whether longitude precedes latitude in `GPS(a, b, third)`: by the terrain, by the third value (a number of
    satellites follows longitude first; a height such as `0.0M`, latitude first), or as only that is on the globe."""
    possible = [order for order, lat in ((True, b), (False, a)) if abs(lat) <= 90]
    covered = [order for order in possible if covers is not None and covers(*((a, b) if order else (b, a)))]
    by_format = [third.isdigit()] if third.isdigit() or third.upper().endswith("M") else []
    for orders in (covered, [order for order in by_format if order in possible], possible):
        if len(orders) == 1:
            return orders[0]
    raise RecordingError(
        f"{path}: GPS({a:g}, {b:g}) does not state whether latitude or longitude comes first: give the site whose DEM "
        "covers the flight (--site), or the frames' positions in a pose file (--poses)"
    )


def _on_globe(lat: float, lon: float) -> bool:
    return abs(lat) <= 90 and abs(lon) <= 180 and (lat, lon) != (0.0, 0.0)


def _fields(block: str) -> dict[str, float]:
    found = {
        key.replace("longtitude", "longitude"): float(value.replace(",", ".")) for key, value in _FIELD.findall(block)
    }
    row = {key: found[key] for key in ("rel_alt", "abs_alt", "gb_yaw", "gb_pitch", "gb_roll") if key in found}
    climb = _CLIMB.search(block)
    if climb is not None:
        row.setdefault("rel_alt", float(climb[1].replace(",", ".")) * _METRES[(climb[2] or "").lower()])
    if "altitude" in found and "abs_alt" not in row:
        row.setdefault("rel_alt", found["altitude"])
    lat, lon = found.get("latitude"), found.get("longitude")
    if lat is not None and lon is not None and _on_globe(lat, lon):
        row |= {"lat": lat, "lon": lon}
    return row


def _gimbal(stamps: Int64Array, columns: dict[str, Float64Array]) -> Attitudes | None:
    known = np.isfinite(columns["gb_yaw"]) & np.isfinite(columns["gb_pitch"])
    if not known.any():
        return None
    angles = np.column_stack([columns["gb_yaw"], columns["gb_pitch"], np.nan_to_num(columns["gb_roll"])])[known]
    matrices = [Pose.from_angles((0.0, 0.0, 0.0), *row).rotation for row in angles]
    return Attitudes(stamps[known], Rotation.from_matrix(np.array(matrices)), "T", None, _GIMBAL_SIGMA_DEG)


def _date(block: str, at: float) -> datetime | None:
    """Return the start time of the video, from a block with a date; no zone is stated."""
    found = _DATE.search(block)
    if found is None:
        return None
    *parts, milli = found.groups()
    try:
        return datetime(*map(int, parts), int(milli or 0) * 1000) - timedelta(seconds=at)  # type: ignore[arg-type,call-arg]
    except (ValueError, OverflowError):
        return None
