"""Correction of the poses of a mount: by how much its yaw, pitch and roll are off, for all that its camera sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.pose import Pose
from ltm_core.pose_estimation.pose_prior import turned
from ltm_core.types import Float64Array

_UNKNOWN = 1.0
"""Variance, rad^2, from which on a direction is not known."""


@dataclass(frozen=True, eq=False)
class PoseCorrection:
    """`rotation`: (3,) rad about the map's axes, by which stated poses are turned; `angles`: (3, 3) covariance of their
    angles then, about these axes, rad^2; None: as it is stated.
    """

    rotation: Float64Array
    angles: Float64Array | None

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
            covariance[:3, :3], covariance[3:, 3:] = stated[:3, :3], self.angles
        return turned(pose, self.rotation), covariance
