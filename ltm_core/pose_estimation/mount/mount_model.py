"""Model a pan-tilt head on a mount, and the correction that all its poses share.

R = R_mount R(pan, tilt + tilt zero): the mount's azimuth, pitch and roll turn the PTZ head as a whole, pan turns about
the PTZ head's own upright axis, tilt about the camera's right."""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose, matrix_of_angles, matrix_of_vector
from ltm_core.pose_estimation.skyline.pose_prior import angle_slopes, turned

_UNKNOWN = 1.0  # variance in rad^2 above which a direction is unknown


@dataclass(frozen=True, eq=False)
class PoseCorrection:
    """Correction of poses. `rotation`: (3,) rad about the map's axes, by which stated poses are turned; `angles`: (3,
    3) covariance of their angles then, about these axes, rad^2; None: as stated.

    `tilt_zero` (rad): by which a PTZ head's camera is turned up about its own right besides, wherever it looks.
    `tilt_covariance`: (4,) of it with the rotation about x, y and z, and its variance."""

    rotation: Float64Array
    angles: Float64Array | None
    tilt_zero: float = 0.0
    tilt_covariance: Float64Array = field(default_factory=lambda: np.zeros(4))

    @property
    def known(self) -> bool:
        """Return whether the angles of a pose are usable with it."""
        return self.angles is None or bool(self.angles.diagonal().max() < _UNKNOWN)

    def applied(self, pose: Pose, covariance: Float64Array) -> tuple[Pose, Float64Array]:
        """Correct a stated pose and its covariance (6, 6) as in `pose_covariance`."""
        if self.angles is not None:
            stated, covariance = covariance, np.zeros((6, 6))
            covariance[:3, :3] = stated[:3, :3]
        # The tilt axis first: it is the PTZ head's own, and leans with what the rotation sets upright.
        tilted = Pose(pose.position, pose.rotation @ matrix_of_vector([self.tilt_zero, 0.0, 0.0]))
        corrected = turned(tilted, self.rotation)
        if self.angles is not None:
            covariance[3:, 3:] = self.angles_at(corrected)
        return corrected, covariance

    def angles_at(self, corrected: Pose) -> Float64Array:
        """Return (3, 3) the angle covariance of a corrected pose; it depends on pan if the tilt zero is uncertain."""
        assert self.angles is not None  # nosec B101 # tells the type checker what holds
        right, cross = corrected.rotation[:, 0], self.tilt_covariance[:3]
        both = np.outer(cross, right)
        return np.asarray(self.angles + both + both.T + self.tilt_covariance[3] * np.outer(right, right), np.float64)


Sign = Literal[1, -1]


@dataclass(frozen=True, eq=False)
class MountModel:
    """Mount of a PTZ head. `base`: the camera's pose at pan 0 and level tilt. `tilt_zero` (rad): added to each tilt.
    `covariance`: (7, 7) as in `MountFit`. `pan_sign`: 1 if pan grows clockwise as seen from above; `tilt_sign`: 1 if
    tilt grows upwards. `encoder_sigma` (rad): repeatability of pan and of tilt."""

    base: Pose
    tilt_zero: float
    covariance: Float64Array
    pan_sign: Sign = 1
    tilt_sign: Sign = 1
    encoder_sigma: float = math.radians(0.03)

    def rotation(self, pan_deg: float, tilt_deg: float) -> Float64Array:
        """Return (3, 3), optical to map."""
        pan, tilt = ptz_angles(pan_deg, tilt_deg, self.pan_sign, self.tilt_sign)
        return np.asarray(self.base.rotation @ matrix_of_angles("YX", (pan, tilt + self.tilt_zero)), np.float64)

    def pose(
        self, pan_deg: float, tilt_deg: float, moved_deg: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[Pose, Float64Array]:
        """Return the camera's pose for encoder readings, and its (6, 6) covariance as in `pose_covariance`.
        `moved_deg`: change of pan and tilt during the exposure."""
        rotation = self.rotation(pan_deg, tilt_deg)
        to_pose = np.zeros((6, 9))
        to_pose[:, :6] = np.eye(6)
        to_pose[3:, 6] = to_pose[3:, 8] = rotation[:, 0]
        to_pose[3:, 7] = self.base.rotation[:, 1]
        within = np.zeros((9, 9))
        within[:7, :7] = self.covariance
        within[7, 7], within[8, 8] = self.encoder_sigma**2 + np.radians(moved_deg) ** 2 / 12
        return Pose(self.base.position, rotation), np.asarray(to_pose @ within @ to_pose.T, np.float64)

    def corrected(
        self, rotation: Float64Array, tilt_zero: float, shift: Float64Array, covariance: Float64Array
    ) -> "MountModel":
        """Return the mount with a correction as in `MountFit`."""
        base = turned(self.base, rotation, shift)
        return replace(self, base=base, tilt_zero=self.tilt_zero + tilt_zero, covariance=covariance)

    @property
    def angle_covariance(self) -> Float64Array:
        """Return the covariance (4, 4) of the mount's azimuth, pitch and roll and its tilt zero, rad^2."""
        to_angles = self._to_angles()
        return np.asarray(to_angles @ self.covariance[3:, 3:] @ to_angles.T, np.float64)

    def with_angle_covariance(self, angles: Float64Array) -> "MountModel":
        """Return the mount with such a covariance (4, 4), rad^2."""
        to_map = np.linalg.inv(self._to_angles())
        covariance = self.covariance.copy()
        covariance[3:, 3:] = to_map @ angles @ to_map.T
        covariance[:3, 3:] = covariance[3:, :3] = 0.0
        return replace(self, covariance=covariance)

    def _to_angles(self) -> Float64Array:
        to_angles = np.eye(4)
        to_angles[:3, :3] = angle_slopes(self.base)
        return to_angles

    def direction_sigma_deg(self, pan_deg: float) -> float:
        """Return the standard deviation of the viewing direction by the calibration alone, across its worse side."""
        still = replace(self, encoder_sigma=0.0)
        pose, covariance = still.pose(pan_deg, 0.0)
        across = pose.rotation[:, :2]
        return math.degrees(math.sqrt(float(np.linalg.eigvalsh(across.T @ covariance[3:, 3:] @ across)[-1])))


def ptz_angles(pan_deg: float, tilt_deg: float, pan_sign: Sign, tilt_sign: Sign) -> tuple[float, float]:
    """Return pan clockwise and tilt upwards, rad."""
    return pan_sign * math.radians(pan_deg), tilt_sign * math.radians(tilt_deg)
