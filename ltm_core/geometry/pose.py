"""Camera poses: position and rotation in the map frame, from and to angles and quaternions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.rotations import matrix_of_quaternion, quaternion_of_matrix


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a camera stands and looks.

    `position`: (3,) metres in the map frame (x grid east, y grid north, z up). `rotation`: (3, 3), optical frame
    (x right, y down, z forward) to map frame. Raises PoseError on NaN or on a matrix that is no rotation.
    """

    position: Float64Array
    rotation: Float64Array

    def __post_init__(self) -> None:
        position = np.array(self.position, np.float64)
        rotation = np.array(self.rotation, np.float64)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise PoseError(f"camera position must be three finite metres, got {position.tolist()}")
        if rotation.shape != (3, 3) or not np.isfinite(rotation).all():
            raise PoseError(f"camera rotation must be a finite 3 x 3 matrix, got {rotation.tolist()}")
        error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if error > 1e-6 or np.linalg.det(rotation) < 0:
            raise PoseError(
                f"camera rotation must be orthonormal and right-handed, got {rotation.tolist()} (off by {error:.3g})"
            )
        position.flags.writeable = rotation.flags.writeable = False
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "rotation", rotation)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Pose):
            return NotImplemented
        return np.array_equal(self.position, other.position) and np.array_equal(self.rotation, other.rotation)

    def __hash__(self) -> int:
        return hash((self.position.tobytes(), self.rotation.tobytes()))

    @classmethod
    def from_angles(
        cls, position: ArrayLike, azimuth_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0
    ) -> Pose:
        """A pose from angles in degrees.

        `azimuth_deg`: of the optical axis, clockwise from grid north. `pitch_deg`: up from the horizon. `roll_deg`:
        of the camera, clockwise about its viewing direction (the image's content turns counter-clockwise).
        """
        angles = (azimuth_deg, pitch_deg, roll_deg)
        if not all(math.isfinite(a) for a in angles):
            raise PoseError(f"camera angles must be finite degrees, got azimuth, pitch, roll = {angles}")
        a, p, r = (math.radians(v) for v in angles)
        forward = np.array([math.sin(a) * math.cos(p), math.cos(a) * math.cos(p), math.sin(p)])
        level_right = np.array([math.cos(a), -math.sin(a), 0.0])
        level_down = np.cross(forward, level_right)
        right = math.cos(r) * level_right + math.sin(r) * level_down
        down = math.cos(r) * level_down - math.sin(r) * level_right
        return cls(np.asarray(position, np.float64), np.column_stack([right, down, forward]))

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """(azimuth in [0, 360), pitch, roll) in degrees.

        Straight down the azimuth is that of the image's top, straight up that of its bottom, and roll is 0.
        """
        right, down, forward = self.rotation.T
        level = math.hypot(forward[0], forward[1])
        pitch = math.atan2(forward[2], level)
        if level > 1e-12:
            azimuth = math.atan2(forward[0], forward[1])
        else:
            top = -down if forward[2] < 0 else down
            azimuth = math.atan2(top[0], top[1])
        level_right = np.array([math.cos(azimuth), -math.sin(azimuth), 0.0])
        roll = math.atan2(-float(down @ level_right), float(right @ level_right))
        return math.degrees(azimuth) % 360.0, math.degrees(pitch), math.degrees(roll)

    @classmethod
    def from_quaternion(cls, position: ArrayLike, quaternion: Sequence[float]) -> Pose:
        """A pose from a quaternion (x, y, z, w), optical to map; refused unless its norm is 1 within 1e-3."""
        q = np.asarray(quaternion, np.float64)
        norm = float(np.linalg.norm(q))
        if q.shape != (4,) or not np.isfinite(q).all() or abs(norm - 1.0) > 1e-3:
            raise PoseError(f"orientation must be a unit quaternion (x, y, z, w), got {q.tolist()} (norm {norm:.6g})")
        return cls(np.asarray(position, np.float64), matrix_of_quaternion(q))

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """(x, y, z, w), optical to map, with w >= 0."""
        x, y, z, w = quaternion_of_matrix(self.rotation)
        return float(x), float(y), float(z), float(w)

    def to_map(self, points_optical: Float64Array) -> Float64Array:
        """Optical-frame points (..., 3) in the map frame."""
        return np.asarray(np.asarray(points_optical) @ self.rotation.T + self.position, np.float64)

    def to_optical(self, points_map: Float64Array) -> Float64Array:
        """Map-frame points (..., 3) in the optical frame."""
        return np.asarray((np.asarray(points_map, np.float64) - self.position) @ self.rotation, np.float64)


def checked_covariance(covariance: ArrayLike) -> Float64Array:
    """Return the covariance of a pose as a (6, 6) matrix. Raises PoseError if it is not a covariance."""
    matrix = np.asarray(covariance, np.float64)
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all():
        raise PoseError(f"a pose covariance must be a finite 6 x 6 matrix, got {matrix.tolist()}")
    size = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > 1e-6 * size or np.linalg.eigvalsh(matrix).min() < -1e-9 * size:
        raise PoseError(f"a pose covariance must be symmetric without negative variances, got {matrix.tolist()}")
    return matrix
