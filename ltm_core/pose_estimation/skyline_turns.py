"""What one picture's skyline says of a turn of its camera about the vertical: how likely it is, by the angle.

A single skyline need not tell by how much a camera is turned, and who weighs it with other evidence needs more than its
best fit: all angles are asked, each with the pitch and roll that suit it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.pose_estimation.picture_evidence import PictureEvidence
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.pose_prior import PosePrior
from ltm_core.pose_estimation.pose_refinement import skyline_cost
from ltm_core.pose_estimation.skyline_search import search_azimuths
from ltm_core.pose_estimation.terrain_horizon import TerrainHorizon
from ltm_core.types import Float64Array

TURN_STEP = math.radians(0.1)
TURN_STEPS = 50
"""To either side: what is turned by more is seen at once."""
SKYLINE_TURNS: Float64Array = TURN_STEP * np.arange(-TURN_STEPS, TURN_STEPS + 1, dtype=np.float64)
"""Radians by which a stated azimuth may be too great, (K,)."""


@dataclass(frozen=True, eq=False)
class SkylineTurns:
    """Of one picture. `logs`: (K,) logarithm of how likely its skyline is by SKYLINE_TURNS, against one that shows
    anything. `azimuth`, `hfov`: radians, of the picture as its pose states them: what looks the same way shares the
    terrain model's errors.
    """

    stamp_ns: int
    azimuth: float
    hfov: float
    logs: Float64Array


def skyline_turns(
    evidence: PictureEvidence, stamp_ns: int, known: PosePrior, horizon: TerrainHorizon, config: PicturePoseConfig
) -> SkylineTurns | None:
    """Of an undistorted picture, about the pose that its camera is said to have; None where too little of a skyline
    fits at any angle: fog, or no sky.
    """
    if evidence.skyline is None:
        return None
    camera: Camera = evidence.camera
    azimuth, pitch, roll = known.pose.angles_deg
    tilt = math.radians(known.pitch_sigma_deg), math.radians(known.roll_sigma_deg)
    azimuths = np.asarray(math.radians(azimuth) - SKYLINE_TURNS[::-1], np.float64)  # they must rise
    found = search_azimuths(evidence.skyline, camera, pitch, roll, tilt, horizon, azimuths, 0.0, config.skyline)
    best = int(np.argmin(found.cost))
    up, over = (math.degrees(float(change[best])) for change in (found.pitch, found.roll))
    there = Pose.from_angles(known.pose.position, math.degrees(float(azimuths[best])), pitch + up, roll + over)
    if skyline_cost(there, camera, evidence, horizon, config)[1] < config.verdict.clear_support:
        return None
    return SkylineTurns(stamp_ns, math.radians(azimuth), math.radians(camera.hfov_deg), -found.cost[::-1])
