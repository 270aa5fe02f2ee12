"""Hold what the sensors of a device recorded, for one photo and along its track."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ltm_core.base.errors import RecordingError
from ltm_core.base.number_text import moment_of_stamp
from ltm_core.base.types import Float64Array, Int64Array
from ltm_core.cameras.sensor_pose import optical_angles_deg


@dataclass(frozen=True, eq=False)
class Sensed:
    """Known values of one photo, each None if unknown. Angles in degrees, lengths in metres.

    `source`: of the values, for the user. `stamp`: exact; None: by EXIF.
    `altitude`: above the WGS 84 ellipsoid if `ellipsoidal`, above sea level if not; None: not stated, probably above
    sea level. `in_flight`: whether a drone took it. `climb`: above the start of the recording, by barometer, and `walk`
    (N, 3), longitude, latitude and climb along the way, if the device was carried on foot. `azimuth_deg`, from true
    ("T") or magnetic ("M") north, `pitch_deg` and `roll_deg` are of the upright image. Sigmas are standard deviations.
    `missing`: reason why there is no position, if known."""

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
    walk: Float64Array | None = None
    azimuth_deg: float | None = None
    azimuth_ref: Literal["T", "M"] | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    tilt_sigma_deg: float | None = None
    missing: str = ""

    def over(self, own: Sensed) -> Sensed:
        """Return this, completed from another: position with height, direction, and tilt, each as a whole."""
        taken: dict[str, Any] = {}
        for names in _PARTS:
            if getattr(self, names[0]) is None:
                taken |= {name: getattr(own, name) for name in names}
        return replace(self, **taken, stamp=own.stamp or self.stamp)


_PARTS = (
    ("lon", "lat", "position_sigma", "altitude", "altitude_sigma", "ellipsoidal"),
    ("azimuth_deg", "azimuth_ref"),
    ("pitch_deg", "roll_deg", "tilt_sigma_deg"),
)
"""Values that belong together, by the one that shows whether they are known."""
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
        """Return values (K,) between the two nearest stamps, those of the nearest beyond the ends, and the known one
        of unknown neighbours."""
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
