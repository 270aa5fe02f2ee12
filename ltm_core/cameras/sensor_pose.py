"""Compute a camera's pose from a satellite fix and the attitude of a device that carries it.

A device states how its axes lie in a world of its own; `ENU_FROM_*` rotate these worlds to east, north, up of its own
north (true or magnetic). Sources: Android's SensorManager (x east, y north, z up), Apple's CMAttitudeReferenceFrame
(x north, z up), and the axes of a phone in both: x to the right of the screen, y to its top, z out of it."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from ltm_core.base.errors import PoseError
from ltm_core.base.number_text import moment_of_stamp
from ltm_core.base.strict_model import Expert, StrictModel
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import (
    UNKNOWN_AZIMUTH_SIGMA_DEG,
    UNKNOWN_PITCH_SIGMA_DEG,
    Pose,
    matrix_of_quaternion,
    pose_covariance,
)
from ltm_core.raster.dem import Dem

ENU_FROM_ENU = np.eye(3)
ENU_FROM_NWU = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation from the world of Apple's CoreMotion (x north, z up) to east, north, up."""


def phone_camera(turned_deg: float = 0.0) -> Float64Array:
    """Return the rotation (3, 3) from the optical frame of an upright photo of the back camera to the phone's axes.

    `turned_deg`: counter-clockwise turn of the phone from portrait: 90 for landscape with the top to the left."""
    turn = math.radians(turned_deg)
    cosine, sine = round(math.cos(turn), 12), round(math.sin(turn), 12)
    return np.array([[cosine, -sine, 0.0], [-sine, -cosine, 0.0], [0.0, 0.0, -1.0]])


def held_phone(enu_from_phone: Float64Array | None, portrait: bool, turned_deg: tuple[float, ...] = ()) -> Float64Array:
    """Return `phone_camera` for the way the phone was held: by `turned_deg`, or by the image's shape so that the image
    is as upright as possible. Without an attitude (None), the first candidate."""
    allowed = turned_deg or ((0.0,) if portrait else (90.0, 270.0))
    mounts = [phone_camera(angle) for angle in allowed]
    if enu_from_phone is None or len(mounts) == 1:
        return mounts[0]
    return min(mounts, key=lambda mount: abs(optical_angles_deg(enu_from_phone @ mount)[2]))


def optical_angles_deg(enu_from_optical: Float64Array) -> tuple[float, float, float]:
    """Return the azimuth from the world's north, pitch and roll of a camera, as used by `Pose.from_angles`.

    Raises PoseError on a matrix that is no rotation."""
    return Pose(np.zeros(3), enu_from_optical).angles_deg


class SensorsConfig(StrictModel):
    """Settings for poses from fixes (sensor_msgs/NavSatFix) and attitudes (sensor_msgs/Imu)."""

    mount: Literal["phone", "phone_sensor"] | tuple[float, float, float, float] = "phone"
    """Orientation of the camera in the attitude's frame: a phone's back camera whose app turns images upright (`phone`)
    or sends them as read, always landscape (`phone_sensor`), or the quaternion (x, y, z, w) of the optical frame as in
    tf."""
    north: Literal["magnetic", "true"] = "magnetic"
    """North of the attitude's world: magnetic (Android) or true (iOS)."""
    geoid_undulation: Expert[float | None] = None
    """Height in metres of the geoid above the ellipsoid of the fixes; None: the height comes from the terrain."""
    height_above_ground: float = Field(1.6, ge=0)
    """Height in metres above the ground, if no altitude is available."""
    fix_age: Expert[float] = Field(15.0, gt=0)
    """Maximum time difference in seconds between a fix and its image."""
    attitude_age: Expert[float] = Field(0.1, gt=0)
    """Maximum time difference in seconds between an attitude and its image."""
    gps_sigma: Expert[float] = Field(5.0, gt=0)
    """Standard deviation in metres of fixes that state no covariance."""
    altitude_sigma: Expert[float] = Field(10.0, gt=0)
    """Standard deviation in metres of the altitude of such fixes."""
    ground_sigma: Expert[float] = Field(1.0, gt=0)
    """Standard deviation in metres of a height above the terrain."""
    compass_sigma_deg: Expert[float] = Field(8.2, gt=0)
    """Standard deviation in degrees of the heading of attitudes that state no covariance."""
    tilt_sigma_deg: Expert[float] = Field(1.0, gt=0)
    """Standard deviation in degrees of pitch and roll of such attitudes."""


@dataclass(frozen=True, eq=False)
class Fix:
    """Position fix. `altitude`: above the ellipsoid, or NaN. `covariance`: (3, 3) of east, north, up, or None."""

    stamp_ns: int
    lon: float
    lat: float
    altitude: float
    covariance: Float64Array | None


@dataclass(frozen=True, eq=False)
class Attitude:
    """Attitude of a device. `rotation`: its axes to east, north, up. `covariance`: (3, 3) about these, or None."""

    stamp_ns: int
    rotation: Float64Array
    covariance: Float64Array | None


def sensed_pose(
    fix: Fix,
    attitude: Attitude,
    stamp_ns: int,
    size: tuple[int, int],
    frame: SiteFrame,
    dem: Dem,
    config: SensorsConfig,
) -> tuple[Pose, Float64Array]:
    """Return the pose of an image of `size` (width, height) and its covariance (6, 6), as in `pose_covariance`.

    Raises PoseError if fix or attitude are of another time, or the ground is needed and not known."""
    times = (("fix", fix.stamp_ns, config.fix_age), ("attitude", attitude.stamp_ns, config.attitude_age))
    for what, stamp, age in times:
        if abs(stamp - stamp_ns) > age * 1e9:
            raise PoseError(
                f"the nearest {what} is {(stamp - stamp_ns) / 1e9:+.2f} s from the image of stamp {stamp_ns} ns, at "
                f"most {age:g} s are allowed: publish it more often, stamped by the clock of the images"
            )
    x, y = (float(v) for v in frame.from_lonlat(fix.lon, fix.lat))
    position_sigma, altitude_sigma = config.gps_sigma, config.altitude_sigma
    if fix.covariance is not None:
        east, north, up = fix.covariance.diagonal()
        position_sigma, altitude_sigma = math.sqrt(max((east + north) / 2, 1e-6)), math.sqrt(max(up, 1e-6))
    ground = float(dem.elevation_at(x, y))
    z, height_sigma = fix.altitude - (config.geoid_undulation or 0.0), altitude_sigma
    if config.geoid_undulation is None or not np.isfinite(z) or z <= ground:
        z, height_sigma = ground + config.height_above_ground, config.ground_sigma
    if not np.isfinite(z):
        raise PoseError(
            f"the fix at lon {fix.lon:.6f}, lat {fix.lat:.6f} lies outside the DEM, so its height is not known: give "
            "`geoid_undulation` under the camera's `sensors` in the site file"
        )
    if config.mount == "phone":
        mount = held_phone(attitude.rotation, portrait=size[1] > size[0])
    elif config.mount == "phone_sensor":
        mount = phone_camera(90.0)
    else:
        mount = matrix_of_quaternion(config.mount)
    azimuth, pitch, roll = optical_angles_deg(attitude.rotation @ mount)
    if config.north == "magnetic":
        grid = frame.magnetic_to_grid_deg(azimuth, x, y, moment_of_stamp(stamp_ns).date(), z)
    else:
        grid = frame.true_to_grid_deg(azimuth, x, y)
    pose = Pose.from_angles((x, y, z), grid, pitch, roll)
    tilt, about = config.tilt_sigma_deg, config.compass_sigma_deg
    if attitude.covariance is not None:
        variances = attitude.covariance.diagonal()
        tilt = min(_degrees(max(variances[:2])), UNKNOWN_PITCH_SIGMA_DEG)
        about = min(_degrees(variances[2]), UNKNOWN_AZIMUTH_SIGMA_DEG)
    return pose, pose_covariance(pose, position_sigma, height_sigma, about, tilt, tilt)


def _degrees(variance: float) -> float:
    return math.degrees(math.sqrt(max(variance, 1e-10)))
