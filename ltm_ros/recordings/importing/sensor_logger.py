"""Read recordings of the phone app Sensor Logger (CSV tables, camera frames), and its values at a photo's time.

Facts of the format (the app's UNITS.md, COORDINATES.md and CROSSPLATFORM.md): `time` is nanoseconds since 1970 UTC;
`altitude` is above the WGS 84 ellipsoid; a negative accuracy marks an invalid value; `bearing` is the course of travel,
not the heading; a camera frame is named by its milliseconds since 1970. The quaternion maps the phone's axes to a world
with x to true north on iOS, and y to magnetic north on Android."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import PurePosixPath
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ltm_core.base.errors import RecordingError
from ltm_core.base.number_text import moment_of_stamp
from ltm_core.base.types import BoolArray, Float64Array, Int64Array
from ltm_core.cameras.sensor_pose import ENU_FROM_ENU, ENU_FROM_NWU, optical_angles_deg
from ltm_ros.recordings.importing.capture_files import CaptureFiles, table
from ltm_ros.recordings.importing.exif import Sensed, number

_FIX_GAP_NS = 15_000_000_000
"""Maximum ns between a photo and the nearest GPS fix: a walker moves 20 m in it. Phones record one fix per second."""
_ATTITUDE_GAP_NS = 500_000_000
"""Maximum ns between a photo and the nearest attitude: a hand rotates a phone by tens of degrees per second."""
_WALKING_SPEED = 1.4
"""Speed in m/s by which a GPS fix of another time becomes less accurate."""
_TILT_SIGMA_DEG = 1.0
"""Standard deviation of pitch and roll from a hand-held phone in degrees: 0.5 to 1."""


@dataclass(frozen=True, eq=False)
class Series:
    """Values (N, K) at `stamp_ns` (N,) ascending; NaN if unknown."""

    stamp_ns: Int64Array
    values: Float64Array

    def at(self, stamp_ns: int) -> list[float]:
        """Return values (K,) between the two nearest stamps, else those of the nearest one."""
        near, _ = _nearest(self.stamp_ns, stamp_ns)
        since, first = self.stamp_ns - self.stamp_ns[0], int(self.stamp_ns[0])
        between = np.array([np.interp(stamp_ns - first, since, column) for column in self.values.T])
        known: list[float] = np.where(np.isfinite(between), between, self.values[near]).tolist()
        return known


@dataclass(frozen=True, eq=False)
class SensorTrack:
    """Record of a phone that was carried at eye height, so that the ground along its track gives the start height.

    `fixes`: longitude, latitude, altitude (`ellipsoidal` as in `Sensed`), and the sigmas of position and altitude.
    `attitude_ns` (M,) ascending: times of the M `rotations` from the phone's axes to east, north, up of `north`: true
    ("T") or magnetic ("M"). `climb`: metres above the start, or None."""

    source: str
    fixes: Series
    ellipsoidal: bool
    attitude_ns: Int64Array
    rotations: Rotation
    north: Literal["T", "M"]
    climb: Series | None = None

    def at(self, stamp_ns: int, device_from_optical: Float64Array) -> Sensed:
        """Return the track's values for a photo: `device_from_optical` (3, 3) is how its camera is mounted."""
        facts: dict[str, Any] = {}
        fixes, climb = self.fixes, self.climb
        near, gap = _nearest(fixes.stamp_ns, stamp_ns)
        if gap > _FIX_GAP_NS:
            facts["missing"] = (
                f"the photo's time {time_of(stamp_ns).isoformat()} is {gap / 1e9:.0f} s from the nearest GPS fix "
                f"({time_of(int(fixes.stamp_ns[near])).isoformat()}): check the clock, or its time zone (--time-zone)"
            )
        else:
            lon, lat, altitude, _, _ = fixes.at(stamp_ns)
            position_sigma, altitude_sigma = fixes.values[near, 3:]
            away = _WALKING_SPEED * max(gap / 1e9 - 1.0, 0.0)  # fixes are one second apart
            facts |= {"lon": lon, "lat": lat, "ellipsoidal": self.ellipsoidal, "altitude": _known(altitude)}
            facts["position_sigma"] = _known(np.hypot(position_sigma, away))
            facts["altitude_sigma"] = _known(altitude_sigma + 0.0 * altitude)  # none without an altitude
        rotation = self.rotation_at(stamp_ns)
        if rotation is not None:
            azimuth, pitch, roll = optical_angles_deg(rotation.as_matrix() @ device_from_optical)
            facts |= {"azimuth_deg": azimuth, "azimuth_ref": self.north}
            facts |= {"pitch_deg": pitch, "roll_deg": roll, "tilt_sigma_deg": _TILT_SIGMA_DEG}
        if climb is not None and _nearest(climb.stamp_ns, stamp_ns)[1] <= _FIX_GAP_NS:
            inside = (fixes.stamp_ns >= climb.stamp_ns[0]) & (fixes.stamp_ns <= climb.stamp_ns[-1])
            heights = np.interp(fixes.stamp_ns[inside], climb.stamp_ns, climb.values[:, 0])
            facts["climb"] = climb.at(stamp_ns)[0]
            facts["walk"] = np.column_stack([fixes.values[inside, :2], heights])
        return Sensed(source=self.source, stamp=time_of(stamp_ns), **facts)

    def rotation_at(self, stamp_ns: int) -> Rotation | None:
        """Return the phone's axes to east, north, up; None without a record at this time."""
        stamps = self.attitude_ns
        if not len(stamps):
            return None
        near, gap = _nearest(stamps, stamp_ns)
        if gap > _ATTITUDE_GAP_NS:
            return None
        if not stamps[0] < stamp_ns < stamps[-1]:
            return self.rotations[near]
        first = int(np.searchsorted(stamps, stamp_ns, "right")) - 1
        share = (stamp_ns - int(stamps[first])) / int(stamps[first + 1] - stamps[first])
        return Slerp([0.0, 1.0], self.rotations[first : first + 2])(share)


def time_of(stamp_ns: int) -> datetime:
    """Return the time in UTC. Raises RecordingError for one outside the calendar."""
    try:
        return moment_of_stamp(stamp_ns)
    except OverflowError as error:
        raise RecordingError(f"time {stamp_ns} ns is not in nanoseconds since 1970") from error


def _nearest(stamps: Int64Array, stamp_ns: int) -> tuple[int, int]:
    """Return the index of the nearest stamp, and its distance."""
    apart = np.abs(stamps - stamp_ns)
    near = int(apart.argmin())
    return near, int(apart[near])


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


_HEIGHTS = ["altitude", "altitudeAboveMeanSeaLevel", "verticalAccuracy"]
_PLACE = ["time", "latitude", "longitude", "horizontalAccuracy", *_HEIGHTS]
_TABLES = {
    "Location": _PLACE,
    "LocationGps": _PLACE,
    "Orientation": ["time", "qx", "qy", "qz", "qw", "yaw", "pitch", "roll"],
    "Barometer": ["time", "relativeAltitude", "pressure"],
    "Metadata": ["platform"],
}
"""The tables that are read, with their columns."""
_FRAME = re.compile(r"\d{10,16}\.jpe?g", re.IGNORECASE)
_AGREE = math.radians(3.0)
"""Maximum difference between a quaternion and the angles beside it."""
_STANDARD_ATMOSPHERE = 44_330.0, 0.1903
"""Metres and exponent of h = a (1 - (p / p0) ^ b)."""


def is_sensor_logger(files: CaptureFiles) -> bool:
    """Return whether these are its tables; no other app writes this set."""
    return any(files.find(f"{name}.csv") for name in ("Location", "LocationGps", "Orientation"))


def camera_frames(files: CaptureFiles) -> dict[str, int]:
    """Return the members that are camera frames, with their stamps in nanoseconds."""
    paths = ((name, PurePosixPath(name)) for name in sorted(files.names))
    frames = ((name, path) for name, path in paths if path.parent.name.lower() == "camera")
    return {name: int(path.stem) * 1_000_000 for name, path in frames if _FRAME.fullmatch(path.name)}


def read_sensor_logger(files: CaptureFiles) -> SensorTrack:
    """Return track and attitude of a zip or folder. Raises RecordingError for invalid tables, or without a position."""
    found = {
        name: table(files, member, columns)
        for name, columns in _TABLES.items()
        if (member := files.find(f"{name}.csv")) is not None
    }
    platform = (found.pop("Metadata", {}).get("platform") or [""])[0].lower()
    tables = {name: _Table(columns, str(files.path), name) for name, columns in found.items()}
    location = tables.get("Location") or tables.get("LocationGps")
    if location is None:
        raise RecordingError(f"{files.path}: without Location: enable the sensor `Location` in the app (or --poses)")
    fixes, ellipsoidal = _fixes(location)
    climb = _climb(tables["Barometer"]) if "Barometer" in tables else None
    nothing = np.zeros(0, np.int64), Rotation.from_quat(np.zeros((0, 4))), False
    stamps, rotations, android = _attitudes(tables["Orientation"], platform) if "Orientation" in tables else nothing
    # The app's setting "standardise" changes the axes, but not the north reference.
    magnetic = platform == "android" or (platform != "ios" and android)
    return SensorTrack("Sensor Logger", fixes, ellipsoidal, stamps, rotations, "M" if magnetic else "T", climb)


class _Table:
    """The numbers of a table, its rows sorted by time, each time once; NaN for invalid ones."""

    def __init__(self, columns: Mapping[str, Sequence[str]], path: str, name: str) -> None:
        self.path, self.name, self.columns = path, name, columns
        if "time" not in columns:
            raise RecordingError(f"{path}: {name} has no column `time`: is it Sensor Logger's?")
        # As integers, because they have too many digits for a double.
        times = (text if text.isascii() and text.isdigit() and len(text) <= 19 else "0" for text in columns["time"])
        stamps, first = np.unique([min(int(text), 2**63 - 1) for text in times], return_index=True)
        self.stamps, self._rows = stamps[stamps > 0].astype(np.int64), first[stamps > 0]

    def column(self, name: str, needed: bool = False) -> Float64Array:
        """Return a column; NaN without it, unless it is `needed`."""
        if name not in self.columns and needed:
            known = f"{', '.join(self.columns)} of those that are read"
            raise RecordingError(
                f"{self.path}: {self.name} has no column {name!r}, but {known}: is it Sensor Logger's?"
            )
        values = self.columns.get(name)
        return np.array([values and number(values[i]) for i in self._rows], np.float64)  # None becomes NaN

    def positive(self, name: str) -> Float64Array:
        """Return accuracies or pressures; zero and negative ones are invalid."""
        values = self.column(name)
        return np.where(values > 0, values, np.nan)


def _fixes(location: _Table) -> tuple[Series, bool]:
    """Return the valid positions, and whether their altitudes are above the ellipsoid."""
    lat, lon = (location.column(name, needed=True) for name in ("latitude", "longitude"))
    accuracy, vertical = (location.positive(name) for name in ("horizontalAccuracy", "verticalAccuracy"))
    # A phone without a GPS fix repeats an old position with a negative accuracy, or writes (0, 0).
    good: BoolArray = (np.abs(lat) <= 90) & (np.abs(lon) <= 180) & ((lat != 0) | (lon != 0))
    if "horizontalAccuracy" in location.columns:
        good &= np.isfinite(accuracy)
    if not good.any():
        what = f"none of {len(good)} positions in Location is valid (negative accuracy, or out of range)"
        raise RecordingError(f"{location.path}: {what}: the phone had no GPS fix; give positions (--poses)")
    sea, ellipsoid = (location.column(name) for name in ("altitudeAboveMeanSeaLevel", "altitude"))
    known = bool(np.isfinite(sea[good]).any())
    altitude = sea if known else ellipsoid
    if "verticalAccuracy" in location.columns:
        altitude = np.where(np.isfinite(vertical), altitude, np.nan)
    values = np.column_stack([lon, lat, altitude, accuracy, vertical])
    return Series(location.stamps[good], values[good]), not known


def _attitudes(orientation: _Table, platform: str) -> tuple[Int64Array, Rotation, bool]:
    """Return stamps, rotations to east, north, up, and whether the axes were Android's."""
    parts = np.column_stack([orientation.column(name, needed=True) for name in ("qx", "qy", "qz", "qw")])
    valid = np.abs(np.linalg.norm(parts, axis=1) - 1) < 0.01
    rotations = Rotation.from_quat(parts[valid])
    angles = np.column_stack([orientation.column(name)[valid] for name in ("yaw", "pitch", "roll")])
    android = bool(valid.any()) and _android_axes(rotations, angles, platform, orientation.path)
    world = Rotation.from_matrix(ENU_FROM_ENU if android else ENU_FROM_NWU)
    return orientation.stamps[valid], world * rotations, android


def _android_axes(rotations: Rotation, angles: Float64Array, platform: str, path: str) -> bool:
    """Return whether the world's y points north, as on Android, by yaw, pitch and roll (N, 3) beside each quaternion.

    The app's documents define the axes by platform, and its setting "standardise" converts those of iOS to Android's:
    the file itself shows which it holds. Without angles, the platform decides."""
    used = np.isfinite(angles).all(axis=1)
    if not used.any():
        if platform not in ("ios", "android"):
            raise RecordingError(f"{path}: the phone's axes are unknown: export the recording with Metadata.csv")
        return platform == "android"
    # R = Rz(yaw) Rx(pitch) Ry(roll) of CMAttitude; SensorManager.getOrientation counts yaw and pitch the other way.
    off = {}
    for android, signs in ((False, (1, 1, 1)), (True, (-1, -1, 1))):
        turns = rotations[used].inv() * Rotation.from_euler("ZXY", angles[used] * signs)
        off[android] = float(np.median(turns.magnitude()))
    likely = min(off, key=lambda key: off[key])
    if off[likely] > _AGREE:
        what = f"{path}: the quaternions of Orientation do not match the yaw, pitch and roll beside them"
        by = f"by {math.degrees(off[likely]):.0f} degrees or more"
        raise RecordingError(f"{what} ({by}): remove Orientation.csv, and give directions in a pose file (--poses)")
    return likely


def _climb(barometer: _Table) -> Series | None:
    metres, pressure = barometer.column("relativeAltitude"), barometer.positive("pressure")
    if not np.isfinite(metres).any() and np.isfinite(pressure).any():
        scale, exponent = _STANDARD_ATMOSPHERE
        metres = scale * (1 - (pressure / pressure[np.isfinite(pressure)][0]) ** exponent)
    known = np.isfinite(metres)
    return Series(barometer.stamps[known], metres[known, None]) if known.any() else None
