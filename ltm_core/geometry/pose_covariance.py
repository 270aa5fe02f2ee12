"""Covariance of a pose from the standard deviations of its place and angles."""

from __future__ import annotations

import math

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose

UNKNOWN_AZIMUTH_SIGMA_DEG = 360 / math.sqrt(12)
"""Standard deviation of a heading of which nothing is known: that of one spread evenly over the circle. Such an angle
is told with a variance that is known and large, so that nothing is placed by it; a variance that is *itself* not known
(infinite, or greater than a half turn's) is taken as the site's `assumed_pose_error`."""
UNKNOWN_PITCH_SIGMA_DEG = 180 / math.sqrt(12)
"""The same of a pitch, from straight down to straight up."""


def axes_of_angles(pose: Pose) -> Float64Array:
    """(3, 3): in its columns the map's directions about which azimuth, pitch and roll (`Pose.from_angles`) turn."""
    azimuth = np.radians(pose.angles_deg[0])
    level_right = (np.cos(azimuth), -np.sin(azimuth), 0.0)
    return np.column_stack([(0.0, 0.0, -1.0), level_right, pose.rotation[:, 2]])


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
    axes = axes_of_angles(pose)
    variances = np.radians([azimuth_sigma_deg, pitch_sigma_deg, roll_sigma_deg]) ** 2
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag([position_sigma**2, position_sigma**2, height_sigma**2])
    covariance[3:, 3:] = (axes * variances) @ axes.T
    return covariance


def moved_covariance(covariance: Float64Array, offset: Float64Array) -> Float64Array:
    """Of a second pose that is fixed to the first, `offset` (3,) metres of the map from it: turned by w, it moves by
    w x offset."""
    x, y, z = offset
    jacobian = np.eye(6)
    jacobian[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return np.asarray(jacobian @ covariance @ jacobian.T)


def sigma_keys(pose: Pose, covariance: Float64Array) -> dict[str, float]:
    """`pose_sigmas` as a pose file has them, three digits each; what is 0 is left out."""
    x, y, z, azimuth, pitch, roll = pose_sigmas(pose, covariance)
    sigmas = {"position_sigma": max(x, y), "height_sigma": z}
    sigmas |= {"azimuth_sigma_deg": azimuth, "pitch_sigma_deg": pitch, "roll_sigma_deg": roll}
    return {key: float(f"{sigma:.3g}") for key, sigma in sigmas.items() if sigma > 0}


def pose_sigmas(pose: Pose, covariance: Float64Array) -> Float64Array:
    """Standard deviations of x, y, z (m), azimuth, pitch and roll (deg), (6,), from a covariance as `pose_covariance`
    makes it: the turns about the map's axes as turns about the vertical, the level right and the viewing direction.
    """
    inverse = np.linalg.pinv(axes_of_angles(pose))
    turns = inverse @ covariance[3:, 3:] @ inverse.T
    variances = np.concatenate([covariance.diagonal()[:3], np.degrees(np.degrees(turns.diagonal()))])
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)), np.float64)
