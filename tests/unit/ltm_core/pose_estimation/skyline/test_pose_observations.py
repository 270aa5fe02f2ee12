from __future__ import annotations

import numpy as np
from scenes.mountain_view import CAMERA, eye, terrain, view

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.contour_scores import ContourDirections
from ltm_core.pose_estimation.skyline.picture_evidence import picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_observations import ridge_observations, skyline_observations
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, turned

CONFIG = PicturePoseConfig()
TRUE = Pose.from_angles(eye(), 63.0, 2.5, 1.2)


def test_errors_of_the_skyline_change_as_their_slopes_say() -> None:
    evidence = picture_evidence(*view(TRUE), CAMERA)
    horizon = terrain().horizon_for(evidence.camera, PosePrior(TRUE, 1.5), CONFIG)
    step = np.array([0.3, -0.2, 0.4, 1e-4, -2e-4, 1.5e-4, 2e-4])

    def rows(sign: float) -> tuple[np.ndarray, np.ndarray]:
        pose = turned(TRUE, sign * step[3:6], sign * step[:3])
        seen = skyline_observations(pose, CAMERA.zoomed(np.exp(sign * step[6])), evidence, horizon, 1.0, CONFIG)
        assert seen is not None
        return seen.error, seen.slopes

    change = rows(1.0)[0] - rows(-1.0)[0]
    told = 2 * rows(0.0)[1] @ step
    # Where a column goes from one point of the horizon to the next its slope leaps.
    assert np.quantile(np.abs(change - told), 0.8) < 0.02 * np.abs(told).max()
    for k in range(7):
        assert np.abs(rows(0.0)[1][:, k]).max() > 0


def test_ridges_that_are_seen_higher_than_predicted_err_as_a_skyline_does() -> None:
    evidence = picture_evidence(*view(TRUE), CAMERA)
    horizon = terrain().horizon_for(evidence.camera, PosePrior(TRUE, 1.5), CONFIG)
    ridges = ContourDirections.of(horizon, CONFIG.contours.nearest, with_horizon=True).in_view(TRUE, CAMERA, 300)
    # Looking up, the terrain is predicted lower in the picture than it is.
    raised = Pose.from_angles(TRUE.position, 63.0, 2.5 + 0.2, 1.2)
    across = ridge_observations(raised, CAMERA, evidence, ridges, horizon.position, 6.0, CONFIG)
    down = skyline_observations(raised, CAMERA, evidence, horizon, 1.0, CONFIG)
    assert across is not None
    assert down is not None
    pixels = CAMERA.fy * np.radians(0.2)
    assert np.median(down.error) > 0.5 * pixels
    assert np.median(across.error[across.weight > 0]) > 0.5 * pixels
    assert across.ground.shape == (len(across.error), 2)
    np.testing.assert_array_less(across.shared, across.sigma)
