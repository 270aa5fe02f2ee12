"""Describe camera poses: rotations, position and angles in the map frame, and their covariance.

SciPy's rotations are loaded on first use: they take 0.2 s and 20 MB, and most processes of a graph (recorder, uplink,
health, the runner) read a site and rotate nothing."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array


def _rotations() -> Any:
    from scipy.spatial.transform import Rotation

    return Rotation


def matrix_of_quaternion(quaternion: ArrayLike) -> Float64Array:
    """Return the matrix (3, 3) of a quaternion (x, y, z, w) of any norm but 0."""
    return np.asarray(_rotations().from_quat(quaternion).as_matrix(), np.float64)


def matrix_of_angles(axes: str, angles: ArrayLike, degrees: bool = False) -> Float64Array:
    """Return the matrices (..., 3, 3) of Euler angles (...), in radians or degrees. `axes`: "XYZ" for Rx Ry Rz."""
    return np.asarray(_rotations().from_euler(axes, angles, degrees).as_matrix(), np.float64)


def matrix_of_vector(vector: ArrayLike) -> Float64Array:
    """Return the matrix (3, 3) of a rotation vector (3,): its axis, as long as its angle in radians."""
    return np.asarray(_rotations().from_rotvec(vector).as_matrix(), np.float64)


def vector_of_matrix(matrix: ArrayLike) -> Float64Array:
    """Return the rotation vector (3,), radians, of (3, 3)."""
    return np.asarray(_rotations().from_matrix(matrix).as_rotvec(), np.float64)


def nearest_vector(vector: Float64Array, to: Float64Array) -> Float64Array:
    """Return the rotation vector (3,) nearest to `to` among those of the same rotation as `vector`, a whole turn
    apart."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return vector
    axis = vector / angle
    turns = round((float(axis @ to) - angle) / (2 * np.pi))
    return np.asarray(vector + 2 * np.pi * turns * axis, np.float64)


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and orientation of a camera.

    `position`: (3,) metres in the map frame (x grid east, y grid north, z up). `rotation`: (3, 3), optical frame
    (x right, y down, z forward) to map frame. Raises PoseError on NaN or on a matrix that is no rotation."""

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
    ) -> "Pose":
        """Return a pose from angles in degrees.

        `azimuth_deg`: of the optical axis, clockwise from grid north. `pitch_deg`: up from the horizon. `roll_deg`:
        of the camera, clockwise about its viewing direction (the image's content turns counter-clockwise)."""
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
        """Return (azimuth in [0, 360), pitch, roll) in degrees.

        Straight down the azimuth is that of the image's top, straight up that of its bottom, and roll is 0."""
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
    def from_quaternion(cls, position: ArrayLike, quaternion: Sequence[float]) -> "Pose":
        """Return a pose from a quaternion (x, y, z, w), optical to map. Raises PoseError unless its norm is 1 within
        1e-3."""
        q = np.asarray(quaternion, np.float64)
        norm = float(np.linalg.norm(q))
        if q.shape != (4,) or not np.isfinite(q).all() or abs(norm - 1.0) > 1e-3:
            raise PoseError(f"orientation must be a unit quaternion (x, y, z, w), got {q.tolist()} (norm {norm:.6g})")
        return cls(np.asarray(position, np.float64), matrix_of_quaternion(q))

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Return (x, y, z, w), optical to map, with w >= 0."""
        x, y, z, w = _rotations().from_matrix(self.rotation).as_quat(canonical=True)
        return float(x), float(y), float(z), float(w)

    def after(self, outer: "Pose") -> "Pose":
        """Return this pose in the frame in which `outer` is given: T_a_c of T_b_c (this) and T_a_b."""
        return Pose(outer.to_map(self.position), outer.rotation @ self.rotation)

    def towards(self, other: "Pose", share: float) -> "Pose":
        """Return the pose at a share [0, 1] of the way to another: linear in position, slerp in rotation."""
        turn = matrix_of_vector(share * vector_of_matrix(other.rotation @ self.rotation.T))
        return Pose(self.position + share * (other.position - self.position), turn @ self.rotation)

    def to_map(self, points_optical: Float64Array) -> Float64Array:
        """Transform optical-frame points (..., 3) to the map frame."""
        return np.asarray(np.asarray(points_optical) @ self.rotation.T + self.position, np.float64)

    def to_optical(self, points_map: Float64Array) -> Float64Array:
        """Transform map-frame points (..., 3) to the optical frame."""
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


UNKNOWN_AZIMUTH_SIGMA_DEG = 360 / math.sqrt(12)
"""Standard deviation in degrees of an unknown heading: that of an angle uniform over the circle. Such an angle has a
known large variance, so nothing is located by it. A variance that is itself unknown (infinite, or greater than that of
half a turn) is replaced by the site's `assumed_pose_error`."""
UNKNOWN_PITCH_SIGMA_DEG = 180 / math.sqrt(12)
"""Standard deviation in degrees of an unknown pitch, uniform from straight down to straight up."""


def axes_of_angles(pose: Pose) -> Float64Array:
    """Return (3, 3): in its columns the map directions about which azimuth, pitch and roll (`Pose.from_angles`)
    turn."""
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
    """Return the covariance (6, 6) over x, y, z (m) and rotations about the map's x, y, z (rad), as in
    geometry_msgs/PoseWithCovariance.

    The errors are independent: azimuth turns about the vertical, pitch about the level axis to the camera's right, roll
    about the viewing direction (`Pose.from_angles`)."""
    axes = axes_of_angles(pose)
    variances = np.radians([azimuth_sigma_deg, pitch_sigma_deg, roll_sigma_deg]) ** 2
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag([position_sigma**2, position_sigma**2, height_sigma**2])
    covariance[3:, 3:] = (axes * variances) @ axes.T
    return covariance


def moved_covariance(covariance: Float64Array, offset: Float64Array) -> Float64Array:
    """Return the covariance of a second pose fixed to the first, `offset` (3,) metres of the map from it: turned by w,
    it moves by w x offset."""
    x, y, z = offset
    jacobian = np.eye(6)
    jacobian[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return np.asarray(jacobian @ covariance @ jacobian.T)


def sigma_keys(pose: Pose, covariance: Float64Array) -> dict[str, float]:
    """Return `pose_sigmas` as in a pose file, three digits each; zeros are omitted."""
    x, y, z, azimuth, pitch, roll = pose_sigmas(pose, covariance)
    sigmas = {"position_sigma": max(x, y), "height_sigma": z}
    sigmas |= {"azimuth_sigma_deg": azimuth, "pitch_sigma_deg": pitch, "roll_sigma_deg": roll}
    return {key: float(f"{sigma:.3g}") for key, sigma in sigmas.items() if sigma > 0}


def pose_sigmas(pose: Pose, covariance: Float64Array) -> Float64Array:
    """Return standard deviations of x, y, z (m), azimuth, pitch and roll (deg), (6,), from a covariance as in
    `pose_covariance`: turns about the map's axes become turns about the vertical, the level right and the viewing
    direction."""
    inverse = np.linalg.pinv(axes_of_angles(pose))
    turns = inverse @ covariance[3:, 3:] @ inverse.T
    variances = np.concatenate([covariance.diagonal()[:3], np.degrees(np.degrees(turns.diagonal()))])
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)), np.float64)
