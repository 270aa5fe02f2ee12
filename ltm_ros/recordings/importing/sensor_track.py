"""Hold what the sensors of a phone recorded along its track."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ltm_core.base.errors import RecordingError
from ltm_core.base.number_text import moment_of_stamp
from ltm_core.base.types import Float64Array, Int64Array
from ltm_core.cameras.sensor_pose import optical_angles_deg
from ltm_ros.recordings.importing.exif import Sensed

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
