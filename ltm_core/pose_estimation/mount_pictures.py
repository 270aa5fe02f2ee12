"""Pictures of one mount, and where a correction that all share puts them.

A state (8,) is a shift (m), a rotation about the map's axes (rad), the zero of the tilt axis (rad) and the logarithm of
the focal length.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

import numpy as np

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.pose_estimation.contour_scores import ContourDirections
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.pose_from_picture import PictureSearch
from ltm_core.pose_estimation.pose_prior import PosePrior, turned
from ltm_core.pose_estimation.pose_refinement import SkylineFit, skyline_fit
from ltm_core.rotations import matrix_of_vector
from ltm_core.types import Float64Array


@dataclass(frozen=True, eq=False)
class MountPicture:
    """A picture as stated (`prior`), what was found in it by itself, and the ridges around."""

    prior: PosePrior
    search: PictureSearch
    ridges: ContourDirections

    def pose(self, state: Float64Array) -> Pose:
        """With a correction (8,)."""
        stated, up = self.prior.pose, matrix_of_vector([state[6], 0.0, 0.0])
        return turned(Pose(stated.position, stated.rotation @ up), state[3:6], state[:3])

    def camera(self, state: Float64Array) -> Camera:
        """With a correction (8,)."""
        return self.search.evidence.camera.zoomed(math.exp(float(state[7])))


def skylines_at(pictures: list[MountPicture], state: Float64Array, config: PicturePoseConfig) -> SkylineFit:
    """Of pictures that have a skyline how it lies on the terrain's, each figure the median; where none has, all fit."""
    fits = [
        skyline_fit(p.pose(state), p.camera(state), p.search.evidence, p.search.horizon, config)
        for p in pictures
        if p.search.evidence.skyline is not None
    ]
    return SkylineFit(*np.median([astuple(fit) for fit in fits], axis=0)) if fits else SkylineFit(support=1.0)


def alike(picture: MountPicture, pictures: list[MountPicture]) -> float:
    """How many pictures look where this one does: they share the DEM's errors, so that they count as one."""
    width = picture.search.evidence.camera.hfov_deg
    azimuth = picture.prior.pose.angles_deg[0]
    away = [abs((p.prior.pose.angles_deg[0] - azimuth + 180.0) % 360.0 - 180.0) for p in pictures]
    return float(sum(max(0.0, 1.0 - a / width) for a in away))
