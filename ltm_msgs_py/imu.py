"""sensor_msgs/Imu to core type: its orientation alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from ltm_core.errors import PoseError
from ltm_core.pose import Pose
from ltm_core.sensor_pose import Attitude
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
