"""Poses as sensors report them: of a tower's mount, of a phone, and without a compass."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.pose_prior import UNKNOWN_DEG, PosePrior
from ltm_core.raster.dem import Dem

_EYE = 1.5
"""Metres that a phone is held over the ground at least, whatever its barometer says."""


class Sensor(StrEnum):
    """What a pose was read from."""

    mount = "mount"
    """A surveyed mast: azimuth 1.5 deg, pitch and roll 0.5; its place is exact."""
    phone = "phone"
    """Compass 6 deg, with one in five drawn from 12 and none beyond 15; pitch and roll 0.7; GPS 5 m, height 4 m."""
    unknown = "no heading"
    """A mount of which no azimuth is known."""


def disturbed(pose: Pose, sensor: Sensor, dem: Dem, rng: np.random.Generator) -> PosePrior:
    """A true pose as `sensor` has it, with the sigmas that it states."""
    azimuth, pitch, roll = pose.angles_deg
    turn, tilt, tail = rng.normal(), rng.normal(size=2), rng.uniform()
    shift, height = rng.normal(size=2), rng.normal()
    if sensor is Sensor.mount:
        told = Pose.from_angles(pose.position, azimuth + 1.5 * turn, pitch + 0.5 * tilt[0], roll + 0.5 * tilt[1])
        return PosePrior(told, 1.5, 0.5, 0.5)
    if sensor is Sensor.unknown:
        told = Pose.from_angles(pose.position, 360.0 * rng.uniform(), pitch + 0.5 * tilt[0], roll + 0.5 * tilt[1])
        return PosePrior(told, UNKNOWN_DEG, 0.5, 0.5)
    away = float(np.clip((12.0 if tail < 0.2 else 6.0) * turn, -15.0, 15.0))
    x, y = pose.position[:2] + 5.0 * shift
    ground = float(dem.elevation_at(x, y))
    z = float(pose.position[2] + 4.0 * height)
    z = max(z, ground + _EYE) if np.isfinite(ground) else z
    told = Pose.from_angles((x, y, z), azimuth + away, pitch + 0.7 * tilt[0], roll + 0.7 * tilt[1])
    return PosePrior(told, 6.0, 0.7, 0.7, 5.0, 4.0)
