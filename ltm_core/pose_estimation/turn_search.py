"""Whether a camera whose pose is known may have been turned: its skyline is asked about some degrees to either side,
for the angle that is clearly likelier, or for how likely each is.

A fit from the known pose does not tell. It reaches a tooth of the skyline or two, and the hill that it then lies on
holds it on the wrong side.
"""

from __future__ import annotations

import math

import numpy as np

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.pose_estimation.image_skyline import ImageSkyline
from ltm_core.pose_estimation.picture_evidence import PictureEvidence
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig, SkylineConfig
from ltm_core.pose_estimation.pose_prior import PosePrior
from ltm_core.pose_estimation.pose_refinement import skyline_fit
from ltm_core.pose_estimation.skyline_search import search_azimuths
from ltm_core.pose_estimation.skyline_turns import SKYLINE_TURNS, SkylineTurns
from ltm_core.pose_estimation.terrain_horizon import TerrainHorizon

_STEP_DEG, _STEPS = 0.25, 8
"""To either side."""
_NEAR = 2
"""Steps within which a fit from the known pose gets by itself."""
_CLEARLY = 2.0
"""By how much a turn must cost less than none."""


def clearer_turn(
    skyline: ImageSkyline, camera: Camera, known: PosePrior, horizon: TerrainHorizon, config: SkylineConfig
) -> Pose | None:
    """The turned pose of which the skyline of an undistorted camera speaks clearly more than of the known one."""
    azimuth, pitch, roll = known.pose.angles_deg
    tilt = math.radians(known.pitch_sigma_deg), math.radians(known.roll_sigma_deg)
    turns = math.radians(_STEP_DEG) * np.arange(-_STEPS, _STEPS + 1)
    azimuths = np.asarray(math.radians(azimuth) + turns, np.float64)
    found = search_azimuths(skyline, camera, pitch, roll, tilt, horizon, azimuths, 0.0, config)
    best = int(np.argmin(found.cost))
    if abs(best - _STEPS) < _NEAR or found.cost[best] > found.cost[_STEPS] - _CLEARLY:
        return None
    up, over = (math.degrees(float(change[best])) for change in (found.pitch, found.roll))
    return Pose.from_angles(known.pose.position, math.degrees(float(azimuths[best])), pitch + up, roll + over)


def skyline_turns(
    evidence: PictureEvidence, stamp_ns: int, known: PosePrior, horizon: TerrainHorizon, config: PicturePoseConfig
) -> SkylineTurns | None:
    """Of an undistorted picture, about the pose that its camera is said to have; None where too little of a skyline
    fits at any angle: fog, or no sky.
    """
    if evidence.skyline is None:
        return None
    camera = evidence.camera
    azimuth, pitch, roll = known.pose.angles_deg
    tilt = math.radians(known.pitch_sigma_deg), math.radians(known.roll_sigma_deg)
    azimuths = np.asarray(math.radians(azimuth) - SKYLINE_TURNS[::-1], np.float64)  # they must rise
    found = search_azimuths(evidence.skyline, camera, pitch, roll, tilt, horizon, azimuths, 0.0, config.skyline)
    best = int(np.argmin(found.cost))
    up, over = (math.degrees(float(change[best])) for change in (found.pitch, found.roll))
    there = Pose.from_angles(known.pose.position, math.degrees(float(azimuths[best])), pitch + up, roll + over)
    if skyline_fit(there, camera, evidence, horizon, config).support < config.verdict.clear_support:
        return None
    return SkylineTurns(stamp_ns, math.radians(azimuth), math.radians(camera.hfov_deg), -found.cost[::-1])
