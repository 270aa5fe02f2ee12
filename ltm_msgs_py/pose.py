"""Pose <-> geometry_msgs/PoseWithCovarianceStamped and PoseStamped.

The pose is that of the camera's optical frame in `header.frame_id`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import Pose as PoseMsg
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from numpy.typing import ArrayLike

from ltm_core.errors import PoseError
from ltm_core.pose import Pose
from ltm_msgs_py.stamp import make_header


def pose_to_msg(
    pose: Pose, stamp_ns: int, frame_id: str = "map", covariance: ArrayLike | None = None
) -> PoseWithCovarianceStamped:
    """A pose with its covariance, (6, 6) over x, y, z (m) and rotations about x, y, z (rad); zeros: not known.

    Raises PoseError on a covariance of another shape or that is not finite.
    """
    msg = PoseWithCovarianceStamped(header=make_header(stamp_ns, frame_id))
    msg.pose.pose = _pose_msg(pose)
    if covariance is not None:
        values = np.asarray(covariance, np.float64)
        if values.shape != (6, 6) or not np.isfinite(values).all():
            raise PoseError(f"pose covariance must be a finite 6 x 6 matrix, got {values.tolist()}")
        msg.pose.covariance = values.ravel()
    return msg


def pose_to_stamped(pose: Pose, stamp_ns: int, frame_id: str = "map") -> PoseStamped:
    """A pose without covariance. Raises MessageError on a bad stamp."""
    return PoseStamped(header=make_header(stamp_ns, frame_id), pose=_pose_msg(pose))


def msg_to_pose(msg: Any, frame_id: str | None = None) -> Pose:
    """The pose of a PoseWithCovarianceStamped or PoseStamped.

    `frame_id`: the frame that the pose must be given in, when it matters. Raises PoseError on another frame, NaN or
    infinite numbers, or a quaternion whose norm is not 1 within 1e-3 (an unset one is zero).
    """
    stamped_in = msg.header.frame_id
    if frame_id is not None and stamped_in != frame_id:
        raise PoseError(f"pose is given in frame {stamped_in!r}, wanted {frame_id!r}")
    pose = msg.pose.pose if hasattr(msg.pose, "pose") else msg.pose
    p, q = pose.position, pose.orientation
    return Pose.from_quaternion((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def _pose_msg(pose: Pose) -> PoseMsg:
    msg = PoseMsg()
    msg.position.x, msg.position.y, msg.position.z = (float(v) for v in pose.position)
    o = msg.orientation
    o.x, o.y, o.z, o.w = pose.quaternion
    return msg
