"""Regions of pictures and located places <-> geometry_msgs.

A region is a PolygonStamped (or PointStamped) in the camera's optical frame whose x and y are pixels u and v; z is not
looked at. A place is a PoseWithCovarianceStamped in `map`: position and its covariance, no orientation.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped

from ltm_core.base.errors import MessageError
from ltm_core.base.types import Float64Array
from ltm_core.locating.region import MOST_VERTICES
from ltm_msgs_py.pose import UNKNOWN_VARIANCES
from ltm_msgs_py.stamp import make_header


def msg_to_outline(msg: Any, frame_id: str) -> Float64Array:
    """Pixels (N, 2) of a PolygonStamped, or (1, 2) of a PointStamped.

    Raises MessageError: another frame, no point, too many, numbers that are not finite.
    """
    if msg.header.frame_id != frame_id:
        raise MessageError(f"region is given in frame {msg.header.frame_id!r}, wanted {frame_id!r}, in pixels")
    points = [msg.point] if hasattr(msg, "point") else msg.polygon.points
    if not 1 <= len(points) <= MOST_VERTICES:
        raise MessageError(f"a region has 1 to {MOST_VERTICES} points, got {len(points)}")
    outline = np.array([(point.x, point.y) for point in points], np.float64)
    if not np.isfinite(outline).all():
        raise MessageError("a region's points must be finite pixels")
    return outline


def place_to_msg(
    place: Float64Array, covariance: Float64Array, height_variance: float, stamp_ns: int, frame_id: str = "map"
) -> PoseWithCovarianceStamped:
    """A place (3,) of the map with its (2, 2) covariance; its orientation is marked as unknown."""
    msg = PoseWithCovarianceStamped(header=make_header(stamp_ns, frame_id))
    position = msg.pose.pose.position
    position.x, position.y, position.z = (float(v) for v in place)
    msg.pose.pose.orientation.w = 1.0
    matrix = np.zeros((6, 6))
    matrix[:2, :2] = covariance
    matrix[2, 2] = height_variance
    matrix[3:, 3:] = np.diag(UNKNOWN_VARIANCES[3:])
    msg.pose.covariance = matrix.ravel()
    return msg
