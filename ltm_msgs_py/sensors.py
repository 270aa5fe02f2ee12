"""Convert sensor_msgs/Imu and NavSatFix to core types."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.cameras.sensor_pose import Attitude, Fix
from ltm_core.geometry.pose import Pose
from ltm_msgs_py.stamp import stamp_of


def msg_to_attitude(msg: Any) -> Attitude:
    """In a world of x east, y north, z up (REP-103, REP-145). A covariance of zeros is not known.

    Raises PoseError where the device states no orientation (covariance[0] = -1), for a quaternion whose norm is not 1,
    and for a covariance that is none.
    """
    covariance = np.array(msg.orientation_covariance, np.float64).reshape(3, 3)
    if covariance[0, 0] == -1.0:
        raise PoseError(
            "the Imu message says that it holds no orientation (orientation_covariance[0] = -1): publish the phone's "
            "rotation vector, or fuse its sensors first (imu_filter_madgwick with a magnetometer)"
        )
    if not np.isfinite(covariance).all() or (covariance.diagonal() < 0).any():
        raise PoseError(
            f"the Imu message's orientation_covariance must be finite without negative variances, got "
            f"{covariance.tolist()}; send zeros where it is not known"
        )
    q = msg.orientation
    rotation = Pose.from_quaternion((0.0, 0.0, 0.0), (q.x, q.y, q.z, q.w)).rotation
    return Attitude(stamp_of(msg), rotation, covariance if covariance.any() else None)


_NO_FIX = -1
_COVARIANCE_UNKNOWN = 0


def msg_to_fix(msg: Any) -> Fix:
    """Raises PoseError: the receiver has no fix, a place off the globe, or a covariance that is none."""
    if msg.status.status == _NO_FIX:
        raise PoseError("the receiver says that it has no fix (status -1): wait for one under open sky")
    lon, lat = float(msg.longitude), float(msg.latitude)
    if not (math.isfinite(lon) and math.isfinite(lat) and abs(lat) <= 90 and abs(lon) <= 180):
        raise PoseError(f"a fix at lat {lat}, lon {lon} is not on the globe")
    if (lat, lon) == (0.0, 0.0):
        raise PoseError("a fix at (0, 0) is what receivers send without one: wait for one under open sky")
    covariance = None
    if msg.position_covariance_type != _COVARIANCE_UNKNOWN:
        covariance = np.array(msg.position_covariance, np.float64).reshape(3, 3)
        if not np.isfinite(covariance).all() or (covariance.diagonal() < 0).any():
            raise PoseError(
                f"the fix's position_covariance must be finite without negative variances, got {covariance.tolist()}; "
                "send position_covariance_type 0 where it is not known"
            )
        if not covariance.diagonal().any():
            covariance = None
    return Fix(stamp_of(msg), lon, lat, float(msg.altitude), covariance)
