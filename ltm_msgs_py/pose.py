"""Pose <-> geometry_msgs/PoseWithCovarianceStamped and PoseStamped.

The pose is that of the camera's optical frame in `header.frame_id`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import Pose as PoseMsg
from geometry_msgs.msg import PoseWithCovarianceStamped
from numpy.typing import ArrayLike

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_msgs_py.stamp import make_header

UNKNOWN_VARIANCES = (99_999.0,) * 3 + (np.pi**2,) * 3
"""Variances from here on say that nothing is known, m^2 and rad^2: drivers write 99999, 1e6, 1e9 or the greatest double
there is, and a direction that is less sure than half a turn is none."""


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


def msg_to_covariance(msg: Any, assumed: Float64Array | None = None) -> Float64Array | None:
    """The covariance of a PoseWithCovarianceStamped, (6, 6) over x, y, z (m) and rotations about x, y, z (rad).

    Unknown are: all of it where all is zero or the first number is -1 (as in sensor_msgs/Imu), and each axis whose
    variance is infinite or `UNKNOWN_VARIANCES` at least. `assumed`: (6, 6), stands for what is unknown; without it the
    answer is None where anything is. Raises PoseError for one that is none: NaN, not symmetric, negative variances.
    """
    given = np.array(msg.pose.covariance, np.float64).reshape(6, 6)
    if given[0, 0] == -1.0 or not given.any():
        return assumed
    variances = given.diagonal()
    if np.isnan(given).any() or (variances < 0).any():
        raise PoseError(
            f"pose covariance has the variances {variances.tolist()}: it must hold numbers, and no negative variances; "
            "send zeros where it is not known"
        )
    known = variances < UNKNOWN_VARIANCES
    matrix = given[np.ix_(known, known)]
    if not np.isfinite(matrix).all():
        raise PoseError(f"pose covariance must be finite where it is known, got {given.tolist()}")
    _check_correlations(matrix)
    if known.all():
        return (given + given.T) / 2
    if assumed is None:
        return None
    filled = np.zeros((6, 6))
    filled[np.ix_(known, known)] = (matrix + matrix.T) / 2
    filled[np.ix_(~known, ~known)] = assumed[np.ix_(~known, ~known)]
    return filled


def _check_correlations(matrix: Float64Array) -> None:
    """Raises PoseError. Metres and radians are of different sizes, so what is compared is without units."""
    sigmas = np.sqrt(matrix.diagonal())
    scale = np.outer(sigmas, sigmas)
    sure = scale == 0  # an axis without any error has none in common with others
    with np.errstate(over="ignore"):
        correlations = matrix / np.where(sure, 1.0, scale)
    if (
        (matrix[sure] != 0).any()
        or (np.abs(correlations) > 1 + 1e-6).any()
        or (np.abs(correlations - correlations.T) > 1e-6).any()
        or (len(matrix) and np.linalg.eigvalsh(correlations).min() < -1e-6)
    ):
        raise PoseError(
            f"pose covariance must be symmetric and without negative eigenvalues, got {matrix.tolist()}; "
            "send zeros where it is not known"
        )


def _pose_msg(pose: Pose) -> PoseMsg:
    msg = PoseMsg()
    msg.position.x, msg.position.y, msg.position.z = (float(v) for v in pose.position)
    o = msg.orientation
    o.x, o.y, o.z, o.w = pose.quaternion
    return msg
