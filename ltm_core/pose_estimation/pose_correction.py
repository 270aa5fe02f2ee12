"""Correction of the poses of a mount: by how much its yaw, pitch and roll are off, for all that its camera sees, and
the zero of a head's tilt axis, about each pose's own right."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ltm_core.pose import Pose
from ltm_core.pose_estimation.pose_prior import turned
from ltm_core.rotations import matrix_of_vector
from ltm_core.types import Float64Array

_UNKNOWN = 1.0
"""Variance, rad^2, from which on a direction is not known."""


@dataclass(frozen=True, eq=False)
class PoseCorrection:
    """`rotation`: (3,) rad about the map's axes, by which stated poses are turned; `angles`: (3, 3) covariance of their
    angles then, about these axes, rad^2; None: as it is stated.

    `tilt_zero` (rad): by which a head's camera is turned up about its own right besides, wherever it looks.
    `tilt_covariance`: (4,) of it with the rotation about x, y and z, and its variance.
    """

    rotation: Float64Array
    angles: Float64Array | None
    tilt_zero: float = 0.0
    tilt_covariance: Float64Array = field(default_factory=lambda: np.zeros(4))

    @property
    def known(self) -> bool:
        """Whether the angles of a pose are of use with it."""
        return self.angles is None or bool(self.angles.diagonal().max() < _UNKNOWN)

    @property
    def held(self) -> bool:
        """Whether pictures have found it, and agree with it still."""
        return self.angles is not None and self.known

    def applied(self, pose: Pose, covariance: Float64Array) -> tuple[Pose, Float64Array]:
        """A stated pose and its covariance (6, 6) as in `pose_covariance`, corrected."""
        if self.angles is not None:
            stated, covariance = covariance, np.zeros((6, 6))
            covariance[:3, :3] = stated[:3, :3]
        # The tilt axis first: it is the head's own, and leans with what the rotation sets upright.
        tilted = Pose(pose.position, pose.rotation @ matrix_of_vector([self.tilt_zero, 0.0, 0.0]))
        corrected = turned(tilted, self.rotation)
        if self.angles is not None:
            covariance[3:, 3:] = self.angles_at(corrected)
        return corrected, covariance

    def angles_at(self, corrected: Pose) -> Float64Array:
        """(3, 3) of a corrected pose: of another at each pan where the tilt zero is not sure."""
        assert self.angles is not None  # nosec B101 # tells the type checker what holds
        right, cross = corrected.rotation[:, 0], self.tilt_covariance[:3]
        both = np.outer(cross, right)
        return np.asarray(self.angles + both + both.T + self.tilt_covariance[3] * np.outer(right, right), np.float64)
