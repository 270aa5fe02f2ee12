"""Read recordings of the phone app Sensor Logger: a zip or folder of CSV tables with camera frames.

Facts of the format (the app's UNITS.md, COORDINATES.md and CROSSPLATFORM.md): `time` is nanoseconds since 1970 UTC;
`altitude` is above the WGS 84 ellipsoid; a negative accuracy marks an invalid value; `bearing` is the course of travel,
not the heading; a camera frame is named by its milliseconds since 1970. The quaternion maps the phone's axes to a world
with x to true north on iOS, and y to magnetic north on Android."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float64Array, Int64Array
from ltm_core.cameras.sensor_pose import ENU_FROM_ENU, ENU_FROM_NWU
from ltm_ros.recordings.importing.capture_files import CaptureFiles, table
from ltm_ros.recordings.importing.sensor_track import Attitudes, Climb, Fixes, SensorTrack, ascending

SOURCE = "Sensor Logger"
_PLACE = (
    *("time", "latitude", "longitude", "altitude", "altitudeAboveMeanSeaLevel", "horizontalAccuracy"),
    "verticalAccuracy",
)
TABLES = {
    "Location": _PLACE,
    "LocationGps": _PLACE,
    "Orientation": ("time", "qx", "qy", "qz", "qw", "yaw", "pitch", "roll"),
    "Barometer": ("time", "relativeAltitude", "pressure"),
    "Metadata": ("platform",),
}
"""The tables that are read, with their columns."""
_FRAME = re.compile(r"\d{10,16}\.jpe?g", re.IGNORECASE)
_TILT_SIGMA_DEG = 1.0
"""Standard deviation of pitch and roll from a hand-held phone in degrees: 0.5 to 1."""
_AGREE = math.radians(3.0)
"""Maximum difference between a quaternion and the angles beside it."""
_STANDARD_ATMOSPHERE = 44_330.0, 0.1903
"""Metres and exponent of h = a (1 - (p / p0) ^ b)."""

Table = Mapping[str, Sequence[str]]


def is_sensor_logger(files: CaptureFiles) -> bool:
    """Return whether these are its tables; no other app writes this set."""
    return any(files.find(f"{name}.csv") for name in ("Location", "LocationGps", "Orientation"))


def read_sensor_logger(files: CaptureFiles) -> SensorTrack:
    """Return track and attitude of a zip or folder. Raises RecordingError for invalid tables, or without a position."""
    tables = {
        name: table(files, member, columns)
        for name, columns in TABLES.items()
        if (member := files.find(f"{name}.csv")) is not None
    }
    return _track(tables, str(files.path))


def camera_frames(files: CaptureFiles) -> dict[str, int]:
    """Return the members that are camera frames, with their stamps in nanoseconds."""
    frames = {}
    for name in files.matching("Camera", (".jpg", ".jpeg")):
        plain = PurePosixPath(name).name
        if _FRAME.fullmatch(plain):
            frames[name] = int(plain.split(".")[0]) * 1_000_000
    return frames


def _track(tables: Mapping[str, Table], place: str) -> SensorTrack:
    location = tables.get("Location") or tables.get("LocationGps")
    if location is None:
        raise RecordingError(
            f"{place}: a Sensor Logger recording without Location: enable the sensor `Location` in the app; give "
            "the photos' positions in a pose file (--poses)"
        )
    metadata = tables.get("Metadata", {})
    orientation, barometer = tables.get("Orientation"), tables.get("Barometer")
    return SensorTrack(
        SOURCE,
        _fixes(location, place),
        None if orientation is None else _attitudes(orientation, _first(metadata, "platform").lower(), place),
        None if barometer is None else _climb(barometer, place),
    )


def _fixes(location: Table, place: str) -> Fixes:
    stamps = _stamps(location, place, "Location")
    lat, lon = (_column(location, name, place, "Location") for name in ("latitude", "longitude"))
    accuracy = _valid(_optional(location, "horizontalAccuracy", len(stamps)))
    # A phone without a GPS fix repeats an old position with a negative accuracy, or writes (0, 0).
    stated = "horizontalAccuracy" in location
    with np.errstate(invalid="ignore"):
        good = (np.abs(lat) <= 90) & (np.abs(lon) <= 180) & ((lat != 0) | (lon != 0))
    good &= np.isfinite(accuracy) if stated else True
    order = ascending(stamps)
    order = order[good[order]]
    if not len(order):
        raise RecordingError(
            f"{place}: none of {len(stamps)} positions in Location is valid (negative accuracy, or out of range): "
            "the phone had no GPS fix; give the photos' positions in a pose file (--poses)"
        )
    vertical = _valid(_optional(location, "verticalAccuracy", len(stamps)))
    sea, ellipsoid = (_optional(location, n, len(stamps)) for n in ("altitudeAboveMeanSeaLevel", "altitude"))
    known = np.isfinite(sea[order]).any()
    altitude = sea if known else ellipsoid
    if "verticalAccuracy" in location:
        altitude = np.where(np.isfinite(vertical), altitude, np.nan)
    return Fixes(stamps[order], lon[order], lat[order], altitude[order], accuracy[order], vertical[order], not known)


def _attitudes(orientation: Table, platform: str, place: str) -> Attitudes | None:
    stamps = _stamps(orientation, place, "Orientation")
    parts = np.column_stack([_column(orientation, name, place, "Orientation") for name in ("qx", "qy", "qz", "qw")])
    norms = np.linalg.norm(parts, axis=1) if len(parts) else np.zeros(0)
    order = ascending(stamps)
    order = order[np.isfinite(norms[order]) & (np.abs(norms[order] - 1) < 0.01)]
    if not len(order):
        return None
    rotations = Rotation.from_quat(parts[order])
    angles = {name: _optional(orientation, name, len(stamps))[order] for name in ("yaw", "pitch", "roll")}
    android = _android_axes(rotations, angles, platform, place)
    world = Rotation.from_matrix(ENU_FROM_ENU if android else ENU_FROM_NWU)
    # The app's setting "standardise" changes the axes, but not the north reference.
    magnetic = platform == "android" or (platform != "ios" and android)
    return Attitudes(stamps[order], world * rotations, "M" if magnetic else "T", None, _TILT_SIGMA_DEG)


def _android_axes(rotations: Rotation, angles: Mapping[str, Float64Array], platform: str, place: str) -> bool:
    """Return whether the world's y points north, as on Android, by the angles beside each quaternion.

    The app's documents define the axes by platform, and its setting "standardise" converts those of iOS to Android's:
    the file itself shows which it holds. Without angles, the platform decides."""
    told = np.column_stack([angles[name] for name in ("yaw", "pitch", "roll")])
    used = np.isfinite(told).all(axis=1)
    if not used.any():
        if platform not in ("ios", "android"):
            raise RecordingError(
                f"{place}: neither Metadata's `platform` nor yaw, pitch and roll determine the phone's axes: "
                "export the recording with Metadata.csv"
            )
        return platform == "android"
    # R = Rz(yaw) Rx(pitch) Ry(roll) of CMAttitude; SensorManager.getOrientation counts yaw and pitch the other way.
    off = {}
    for android, signs in ((False, (1, 1, 1)), (True, (-1, -1, 1))):
        turns = rotations[used].inv() * Rotation.from_euler("ZXY", told[used] * signs)
        off[android] = float(np.median(turns.magnitude()))
    likely = min(off, key=lambda key: off[key])
    if off[likely] > _AGREE:
        raise RecordingError(
            f"{place}: the quaternions of Orientation do not match the yaw, pitch and roll beside them (off by "
            f"{math.degrees(off[likely]):.0f} degrees or more in either platform's axes): remove Orientation.csv, "
            "and give the photos' directions in a pose file (--poses)"
        )
    return likely


def _climb(barometer: Table, place: str) -> Climb | None:
    stamps = _stamps(barometer, place, "Barometer")
    metres = _optional(barometer, "relativeAltitude", len(stamps))
    pressure = _valid(_optional(barometer, "pressure", len(stamps)))
    order = ascending(stamps)
    if not np.isfinite(metres).any() and np.isfinite(pressure).any():
        first = pressure[order][np.isfinite(pressure[order])][0]
        scale, exponent = _STANDARD_ATMOSPHERE
        metres = scale * (1 - (pressure / first) ** exponent)
    order = order[np.isfinite(metres[order])]
    return Climb(stamps[order], metres[order]) if len(order) else None


def _first(columns: Table, name: str) -> str:
    values: Any = columns.get(name) or [""]
    return str(values[0])


def _column(columns: Table, name: str, place: str, what: str) -> Float64Array:
    if name not in columns:
        raise RecordingError(
            f"{place}: {what} has no column {name!r}, but {', '.join(columns) or 'none'} of those that are read: is it "
            "Sensor Logger's?"
        )
    return _numbers(columns[name])


def _optional(columns: Table, name: str, count: int) -> Float64Array:
    return _numbers(columns[name]) if name in columns else np.full(count, np.nan)


def _numbers(values: Sequence[str]) -> Float64Array:
    """Return numbers; NaN for invalid ones."""
    out = np.full(len(values), np.nan)
    for i, value in enumerate(values):
        try:
            number = float(value)
        except ValueError:
            continue
        if math.isfinite(number):
            out[i] = number
    return out


def _valid(values: Float64Array) -> Float64Array:
    """Return accuracies and pressures; zero and negative ones are invalid."""
    with np.errstate(invalid="ignore"):
        return np.where(values > 0, values, np.nan)


def _stamps(columns: Table, place: str, what: str) -> Int64Array:
    """Return nanoseconds as integers, because they have too many digits for a double; 0 for none."""
    if "time" not in columns:
        raise RecordingError(f"{place}: {what} has no column `time`: is it Sensor Logger's?")
    stamps = np.zeros(len(columns["time"]), np.int64)
    for i, value in enumerate(columns["time"]):
        if value.isascii() and value.isdigit() and len(value) <= 19:
            stamps[i] = min(int(value), 2**63 - 1)
    return stamps
