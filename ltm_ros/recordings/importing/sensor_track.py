"""Hold what the sensors of a device recorded, for one photo and along its track."""

from __future__ import annotations

import bisect
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ltm_core.base.errors import RecordingError
from ltm_core.base.number_text import moment_of_stamp
from ltm_core.base.types import Float64Array, Int64Array
from ltm_core.cameras.sensor_pose import optical_angles_deg


@dataclass(frozen=True, eq=False)
class Walk:
    """Track of a device at eye height: `lon`, `lat` (N,) WGS 84 degrees, and its `climb` (N,)."""

    lon: Float64Array
    lat: Float64Array
    climb: Float64Array


@dataclass(frozen=True, eq=False)
class Sensed:
    """Known values of one photo, each None if unknown. Angles in degrees, lengths in metres.

    `source`: of the values, for the user. `stamp`: exact; None: by EXIF.
    `altitude`: above the WGS 84 ellipsoid if `ellipsoidal`, above sea level if not; None: not stated, probably above
    sea level. `in_flight`: whether a drone took it. `climb`: above the start of the recording, by barometer, and `walk`
    if the device was carried on foot. `azimuth_deg`, from true ("T") or magnetic ("M") north, `pitch_deg` and
    `roll_deg` are of the upright image. Sigmas are standard deviations."""

    source: str = "EXIF"
    stamp: datetime | None = None
    lon: float | None = None
    lat: float | None = None
    position_sigma: float | None = None
    altitude: float | None = None
    altitude_sigma: float | None = None
    ellipsoidal: bool | None = None
    in_flight: bool = False
    climb: float | None = None
    walk: Walk | None = None
    azimuth_deg: float | None = None
    azimuth_ref: Literal["T", "M"] | None = None
    azimuth_sigma_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    tilt_sigma_deg: float | None = None
    missing: str = ""
    """Reason why there is no position, if known."""

    def over(self, own: Sensed) -> Sensed:
        """Return this, completed from another: position with height, direction, and tilt, each as a whole."""
        taken: dict[str, object] = {}
        for names in _PARTS:
            if getattr(self, names[0]) is None:
                taken |= {name: getattr(own, name) for name in names}
        if own.stamp is not None:
            taken["stamp"] = own.stamp
        return replace(self, **taken)  # type: ignore[arg-type]


_PARTS = (
    ("lon", "lat", "position_sigma", "altitude", "altitude_sigma", "ellipsoidal"),
    ("azimuth_deg", "azimuth_ref", "azimuth_sigma_deg"),
    ("pitch_deg", "roll_deg", "tilt_sigma_deg"),
)
"""Values that belong together, by the one that shows whether they are known."""


_FIX_GAP_NS = 15_000_000_000
"""Maximum ns between a photo and the nearest GPS fix: a walker moves 20 m in it. Phones record one fix per second."""
_ATTITUDE_GAP_NS = 500_000_000
"""Maximum ns between a photo and the nearest attitude: a hand rotates a phone by tens of degrees per second."""
_WALKING_SPEED = 1.4
"""Speed in m/s by which a GPS fix of another time becomes less accurate."""


@dataclass(frozen=True, eq=False)
class Fixes:
    """`stamp_ns` (N,) ascending; `lon`, `lat` WGS 84 degrees; `altitude` as in `Sensed` and both sigmas in metres (N,),
    NaN if unknown."""

    stamp_ns: Int64Array
    lon: Float64Array
    lat: Float64Array
    altitude: Float64Array
    position_sigma: Float64Array
    altitude_sigma: Float64Array
    ellipsoidal: bool | None = None


@dataclass(frozen=True, eq=False)
class Attitudes:
    """`stamp_ns` (M,) ascending; `rotations`: M, the device's axes to east, north, up of `north`: true ("T"), magnetic
    ("M"), or None where the heading means nothing. Sigmas in degrees, None where the device states none."""

    stamp_ns: Int64Array
    rotations: Rotation
    north: Literal["T", "M"] | None
    heading_sigma_deg: float | None = None
    tilt_sigma_deg: float | None = None


@dataclass(frozen=True, eq=False)
class Climb:
    """`metres` (K,) above where the recording began, at `stamp_ns` (K,) ascending."""

    stamp_ns: Int64Array
    metres: Float64Array


@dataclass(frozen=True, eq=False)
class SensorTrack:
    """Record of a phone that was carried at eye height, so that the ground along its track gives the start height."""

    source: str
    fixes: Fixes | None = None
    attitudes: Attitudes | None = None
    climb: Climb | None = None

    def at(self, stamp_ns: int, device_from_optical: Float64Array) -> Sensed:
        """Return the track's values for a photo: `device_from_optical` (3, 3) is how its camera is mounted."""
        facts: dict[str, object] = {}
        position = self._position(stamp_ns)
        if isinstance(position, str):
            facts["missing"] = position
        else:
            facts |= position
        facts |= self._angles(stamp_ns, device_from_optical)
        climb = self._climbed(stamp_ns)
        if climb is not None:
            facts |= {"climb": climb, "walk": self._walk}
        return Sensed(source=self.source, stamp=time_of(stamp_ns), **facts)  # type: ignore[arg-type]

    def rotation_at(self, stamp_ns: int) -> Rotation | None:
        """Return the device's axes to east, north, up; None without a record at this time."""
        told = self.attitudes
        if told is None or not len(told.stamp_ns):
            return None
        near, gap = _nearest(told.stamp_ns, stamp_ns)
        if gap > _ATTITUDE_GAP_NS:
            return None
        first = min(max(bisect.bisect_right(told.stamp_ns, stamp_ns) - 1, 0), max(len(told.stamp_ns) - 2, 0))
        pair = told.stamp_ns[first : first + 2]
        if len(pair) < 2 or pair[0] == pair[1] or not pair[0] <= stamp_ns <= pair[1]:
            return told.rotations[near]
        return Slerp([0.0, 1.0], told.rotations[first : first + 2])((stamp_ns - pair[0]) / (pair[1] - pair[0]))

    def _position(self, stamp_ns: int) -> dict[str, object] | str:
        fixes = self.fixes
        if fixes is None or not len(fixes.stamp_ns):
            return "it has no GPS fix"
        near, gap = _nearest(fixes.stamp_ns, stamp_ns)
        if gap > _FIX_GAP_NS:
            return (
                f"the photo's time {time_of(stamp_ns).isoformat()} is {gap / 1e9:.0f} s from the nearest GPS fix "
                f"({time_of(int(fixes.stamp_ns[near])).isoformat()}): check the clock, or its time zone (--time-zone)"
            )
        facts: dict[str, object] = {
            "lon": _at(fixes.stamp_ns, fixes.lon, stamp_ns),
            "lat": _at(fixes.stamp_ns, fixes.lat, stamp_ns),
            "ellipsoidal": fixes.ellipsoidal,
        }
        altitude = _at(fixes.stamp_ns, fixes.altitude, stamp_ns)
        if np.isfinite(altitude):
            facts["altitude"] = altitude
            if np.isfinite(fixes.altitude_sigma[near]):
                facts["altitude_sigma"] = float(fixes.altitude_sigma[near])
        if np.isfinite(fixes.position_sigma[near]):
            away = _WALKING_SPEED * max(gap / 1e9 - 1.0, 0.0)  # fixes are one second apart
            facts["position_sigma"] = float(np.hypot(fixes.position_sigma[near], away))
        return facts

    def _angles(self, stamp_ns: int, device_from_optical: Float64Array) -> dict[str, object]:
        rotation, told = self.rotation_at(stamp_ns), self.attitudes
        if rotation is None or told is None:
            return {}
        azimuth, pitch, roll = optical_angles_deg(rotation.as_matrix() @ device_from_optical)
        facts: dict[str, object] = {"pitch_deg": pitch, "roll_deg": roll, "tilt_sigma_deg": told.tilt_sigma_deg}
        if told.north is not None:
            facts |= {"azimuth_deg": azimuth, "azimuth_ref": told.north, "azimuth_sigma_deg": told.heading_sigma_deg}
        return facts

    def _climbed(self, stamp_ns: int) -> float | None:
        if self.climb is None or not len(self.climb.stamp_ns):
            return None
        _, gap = _nearest(self.climb.stamp_ns, stamp_ns)
        return _at(self.climb.stamp_ns, self.climb.metres, stamp_ns) if gap <= _FIX_GAP_NS else None

    @cached_property
    def _walk(self) -> Walk | None:
        fixes, climb = self.fixes, self.climb
        if fixes is None or climb is None:
            return None
        inside = (fixes.stamp_ns >= climb.stamp_ns[0]) & (fixes.stamp_ns <= climb.stamp_ns[-1])
        heights = np.interp(fixes.stamp_ns[inside], climb.stamp_ns, climb.metres)
        return Walk(fixes.lon[inside], fixes.lat[inside], heights) if inside.any() else None


def time_of(stamp_ns: int) -> datetime:
    """Return the time in UTC. Raises RecordingError for one outside the calendar."""
    try:
        return moment_of_stamp(stamp_ns)
    except OverflowError as error:
        raise RecordingError(f"time {stamp_ns} ns is not in nanoseconds since 1970") from error


def ascending(stamp_ns: Int64Array) -> Int64Array:
    """Return indices that sort stamps (N,), each once; 0 means none, and is ignored."""
    values, first = np.unique(stamp_ns, return_index=True)
    return np.asarray(first[values > 0], np.int64)


def _nearest(stamps: Int64Array, stamp_ns: int) -> tuple[int, int]:
    """Return the index of the nearest stamp, and its distance."""
    after = bisect.bisect_left(stamps, stamp_ns)
    near = min((i for i in (after - 1, after) if 0 <= i < len(stamps)), key=lambda i: abs(int(stamps[i]) - stamp_ns))
    return near, abs(int(stamps[near]) - stamp_ns)


def _at(stamps: Int64Array, values: Float64Array, stamp_ns: int) -> float:
    """Interpolate between the two nearest, use the nearest beyond the ends, and the known one of unknown neighbours."""
    near, _ = _nearest(stamps, stamp_ns)
    between = float(np.interp(stamp_ns - int(stamps[0]), stamps - stamps[0], values))
    return between if np.isfinite(between) else float(values[near])
