"""Covariance of a pose from the standard deviations of its place and angles."""

from __future__ import annotations

import numpy as np

from ltm_core.pose import Pose
from ltm_core.types import Float64Array


def pose_covariance(
    pose: Pose,
    position_sigma: float,
    height_sigma: float,
    azimuth_sigma_deg: float,
    pitch_sigma_deg: float,
    roll_sigma_deg: float,
) -> Float64Array:
    """(6, 6) over x, y, z (m) and rotations about the map's x, y, z (rad), as in geometry_msgs/PoseWithCovariance.

    The errors are independent: azimuth turns about the vertical, pitch about the level axis to the camera's right, roll
    about the viewing direction (`Pose.from_angles`).
    """
    azimuth = np.radians(pose.angles_deg[0])
    right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    axes = np.column_stack([[0.0, 0.0, 1.0], right, pose.rotation[:, 2]])
    variances = np.radians([azimuth_sigma_deg, pitch_sigma_deg, roll_sigma_deg]) ** 2
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag([position_sigma**2, position_sigma**2, height_sigma**2])
    covariance[3:, 3:] = (axes * variances) @ axes.T
    return covariance
