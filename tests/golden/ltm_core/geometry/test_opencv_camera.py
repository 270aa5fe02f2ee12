"""Our camera model against OpenCV's."""

import cv2
import numpy as np
import pytest

from ltm_core.geometry.camera import Camera

CAMERAS = [
    Camera(96, 61, 80.0, 83.0, 45.0, 33.0),
    Camera(96, 61, 80.0, 83.0, 45.0, 33.0, (-0.21, 0.08, 0.002, -0.003, -0.01)),
    Camera(96, 61, 80.0, 83.0, 51.5, 27.0, (0.12, -0.02, -0.004, 0.001, 0.003)),
    Camera(4290, 2856, 6017.0, 6017.0, 2144.5, 1427.5, (-0.1155, 0.0, 0.0, 0.0, 0.0)).scaled(61),
]


@pytest.mark.parametrize("camera", CAMERAS)
def test_project(camera: Camera) -> None:
    rng = np.random.default_rng(7)
    points = np.concatenate([rng.uniform(-0.6, 0.6, (500, 2)), np.ones((500, 1))], axis=1) * rng.uniform(
        1, 900, (500, 1)
    )
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    np.testing.assert_allclose(camera.project(points), theirs[:, 0], atol=1e-8)


@pytest.mark.parametrize("camera", CAMERAS)
def test_rays(camera: Camera) -> None:
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 500, 1e-12)
    # OpenCV 5 took the variant that iterates to a criterion into undistortPoints, which stops after 5 steps in 4.
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    theirs = undistort(pixels, camera.matrix, np.array(camera.distortion), R=None, P=None, criteria=criteria)[:, 0]
    rays = camera.rays().reshape(-1, 3)
    assert np.isfinite(rays).all()
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(rays[:, :2] / rays[:, 2:], theirs, atol=1e-8)
