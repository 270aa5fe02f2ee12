"""Correction of a mount <-> geometry_msgs/PoseWithCovarianceStamped. A covariance of zeros: as it is stated.

A correction moves nothing: x stands for the zero of a head's tilt axis (rad), 0 where none is known of.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ltm_core.geometry.pose import Pose
from ltm_core.geometry.rotations import matrix_of_vector, vector_of_matrix
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose, pose_to_msg


def correction_to_msg(correction: PoseCorrection, stamp_ns: int) -> Any:
    """`stamp_ns`: of the last picture that it comes from."""
    turn = Pose(np.array([correction.tilt_zero, 0.0, 0.0]), matrix_of_vector(correction.rotation))
    covariance = np.zeros((6, 6))
    if correction.angles is not None:
        covariance[3:, 3:] = correction.angles
        covariance[0, 3:] = covariance[3:, 0] = correction.tilt_covariance[:3]
        covariance[0, 0] = correction.tilt_covariance[3]
    return pose_to_msg(turn, stamp_ns, "map", covariance)


def msg_to_correction(msg: Any) -> PoseCorrection:
    """Raises PoseError as `msg_to_pose` and `msg_to_covariance` do."""
    covariance = msg_to_covariance(msg)
    pose = msg_to_pose(msg, "map")
    rotation, tilt_zero = vector_of_matrix(pose.rotation), float(pose.position[0])
    if covariance is None:
        return PoseCorrection(rotation, None, tilt_zero)
    return PoseCorrection(rotation, covariance[3:, 3:], tilt_zero, np.append(covariance[0, 3:], covariance[0, 0]))
