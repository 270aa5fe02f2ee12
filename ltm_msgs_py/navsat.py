"""sensor_msgs/NavSatFix to core type."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ltm_core.errors import PoseError
from ltm_core.sensor_pose import Fix
from ltm_msgs_py.stamp import stamp_of

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
