"""Prior knowledge of a pose before its image is used."""

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import (
    UNKNOWN_AZIMUTH_SIGMA_DEG,
    Pose,
    axes_of_angles,
    matrix_of_vector,
    pose_covariance,
    pose_sigmas,
)

UNKNOWN_DEG = UNKNOWN_AZIMUTH_SIGMA_DEG  # standard deviation of an unknown azimuth in degrees


@dataclass(frozen=True, eq=False)
class PosePrior:
    """Prior pose with independent standard deviations: degrees of azimuth, pitch and roll, metres of x and y, and of z.
    An azimuth sigma of UNKNOWN_DEG or more says that the heading is unknown. A position sigma of 0 holds the position.
    Raises PoseError for sigmas that are none."""

    pose: Pose
    azimuth_sigma_deg: float = 1.5
    pitch_sigma_deg: float = 0.5
    roll_sigma_deg: float = 0.5
    position_sigma: float = 0.0
    height_sigma: float = 0.0

    def __post_init__(self) -> None:
        angles = (self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg)
        if not all(math.isfinite(s) and s > 0 for s in angles):
            raise PoseError(f"sigmas of azimuth, pitch and roll must be positive degrees, got {angles}")
        places = (self.position_sigma, self.height_sigma)
        if not all(math.isfinite(s) and s >= 0 for s in places):
            raise PoseError(f"sigmas of position and height must be metres, 0 or more, got {places}")

    @classmethod
    def of_covariance(cls, pose: Pose, covariance: Float64Array) -> "PosePrior":
        """Return the prior of a (6, 6) covariance as in `pose_covariance`. Raises PoseError if its angles have none."""
        x, y, height, azimuth, pitch, roll = pose_sigmas(pose, covariance).tolist()
        return cls(pose, azimuth, pitch, roll, max(x, y), height)

    @property
    def heading_known(self) -> bool:
        return self.azimuth_sigma_deg < 0.99 * UNKNOWN_DEG  # it may have come through a covariance

    @property
    def sigmas(self) -> Float64Array:
        """Return (6,) sigmas: x, y, z (m), azimuth, pitch, roll (rad)."""
        angles = np.radians([self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg])
        return np.array([self.position_sigma, self.position_sigma, self.height_sigma, *angles])

    @property
    def covariance(self) -> Float64Array:
        """Return the covariance (6, 6) as in `pose_covariance`."""
        angles = (self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg)
        return pose_covariance(self.pose, self.position_sigma, self.height_sigma, *angles)

    def deviation(self, pose: Pose) -> Float64Array:
        """Return (6,) the deviation of a pose from this one: x, y, z (m), azimuth, pitch, roll (rad)."""
        return np.concatenate([pose.position - self.pose.position, angles_between(self.pose, pose)])


def angles_between(a: Pose, b: Pose) -> Float64Array:
    """Return the azimuth, pitch and roll (3,), radians in [-pi, pi), by which `b` differs from `a`."""
    change = np.radians(np.subtract(b.angles_deg, a.angles_deg))
    return np.asarray((change + math.pi) % (2 * math.pi) - math.pi, np.float64)


def angle_slopes(pose: Pose) -> Float64Array:
    """Return (3, 3) derivatives of azimuth, pitch and roll (rad) by rotations about the map's x, y and z (rad).
    Straight up or down, where azimuth and roll have one axis, each takes half of a turn about it."""
    return np.asarray(np.linalg.pinv(axes_of_angles(pose)), np.float64)


def turned(pose: Pose, rotation: Float64Array, shift: Float64Array | None = None) -> Pose:
    """Return a pose turned by a rotation vector (3,) about the map's axes, and shifted."""
    matrix = matrix_of_vector(rotation) @ pose.rotation
    u, _, vt = np.linalg.svd(matrix)  # many small turns stay a rotation
    return Pose(pose.position if shift is None else pose.position + shift, u @ vt)
