import math

import numpy as np
import pytest

from ltm_core.fuel.rules import FusionRules
from ltm_core.fuel.votes import cell_visibility
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, Pose, pose_covariance
from ltm_core.raster.dem import Dem
from ltm_core.surface.config import PoseErrorConfig
from ltm_msgs_py.pose import UNKNOWN_VARIANCES, msg_to_covariance, pose_to_msg

POSE = Pose.from_angles((0.0, 0.0, 31.6), 40.0, 0.0, 0.0)
SURE = (5.0, 10.0, 8.2, 1.0, 1.0)


@pytest.mark.parametrize(
    "sigmas",
    [
        (5.0, 10.0, UNKNOWN_AZIMUTH_SIGMA_DEG, 1.0, 1.0),
        (5.0, 10.0, 8.2, UNKNOWN_PITCH_SIGMA_DEG, 3.0),
        (5.0, 10.0, UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, 3.0),
    ],
)
def test_it_survives_the_wire_and_no_far_cell_gets_evidence(sigmas: tuple[float, ...]) -> None:
    covariance = pose_covariance(POSE, *sigmas)
    assert (covariance.diagonal() < UNKNOWN_VARIANCES).all()  # else it would be taken as the site assumes
    received = msg_to_covariance(pose_to_msg(POSE, 7, covariance=covariance), PoseErrorConfig().covariance())
    np.testing.assert_allclose(received, covariance, atol=1e-12)
    x, y = np.array([180.0, 260.0, 900.0]), np.array([220.0, 300.0, 1100.0])
    dem = Dem(np.zeros((150, 140), np.float32), GridGeometry(-100.0, 1350.0, 10.0, 140, 150, "EPSG:32611"))
    camera = Camera.from_fov(640, 480, 60.0)
    unknown = cell_visibility(x, y, dem, 30.0, camera, POSE, covariance=received)
    sure = cell_visibility(x, y, dem, 30.0, camera, POSE, covariance=pose_covariance(POSE, *SURE))
    most = FusionRules().max_sigma
    assert (np.maximum(unknown.sigma_along, unknown.sigma_across) > most).all()
    assert math.isclose(
        float(sure.sigma_across[0]), math.hypot(5.0, math.radians(8.2) * math.hypot(180, 220)), rel_tol=0.03
    )
