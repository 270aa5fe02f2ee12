from dataclasses import replace

import numpy as np
import pytest

from ltm_core.base.errors import PoseError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.lens import LensPrior, corner_radius
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.pose_estimation.points.resection import resect
from ltm_core.visibility.footprint import pixel_rays

STATED = Camera(1920, 1080, 1484.0, 1484.0, 959.5, 539.5)
LENS = replace(STATED, fx=1420.0, fy=1420.0, cx=968.0, cy=533.0, distortion=(-0.26, 0.07, 0.0, 0.0, -0.01))
POSE = Pose.from_angles((10.0, 20.0, 900.0), 62.0, -7.0, 1.0)


def points(count: int, noise: float, seed: int = 3) -> ControlPoints:
    rng = np.random.default_rng(seed)
    pixels = np.column_stack([rng.uniform(40, 1880, count), rng.uniform(40, 1040, count)])
    places = POSE.position + pixel_rays(LENS, pixels) @ POSE.rotation.T * rng.uniform(200, 2500, (count, 1))
    return ControlPoints(tuple(f"p{k}" for k in range(count)), places, pixels + rng.normal(0, noise, pixels.shape))


def test_a_free_lens_is_found_and_a_fixed_one_is_named() -> None:
    marked = points(40, 0.5)
    fixed = resect(marked, LENS, POSE.position, free=("focal",))
    assert fixed.bending is None, "the stated lens is right"
    wrong = resect(marked, replace(LENS, distortion=(-0.20, 0.07, 0.0, 0.0, -0.01)), POSE.position, free=())
    assert wrong.bending is not None
    assert wrong.bending[0] == "k1"
    assert wrong.bending[1].k == pytest.approx(-0.06, abs=0.02)
    free = resect(marked, STATED, POSE.position, lens=LensPrior.of("any", STATED))
    assert set(free.fitted) >= {"focal", "k1", "k2", "k3", "centre"}
    assert not free.held
    assert not free.outliers
    turned = np.subtract(free.pose.angles_deg, POSE.angles_deg)
    assert (np.abs(turned) < 4 * np.array([free.sigmas[f"{a}_deg"] for a in ("azimuth", "pitch", "roll")])).all()
    assert np.median(free.residual_px) < 1.0, "as marked"
    away = {"fx": free.camera.fx - LENS.fx, "cx": free.camera.cx - LENS.cx, "k1": free.camera.distortion[0] + 0.26}
    assert all(abs(value) < 4 * free.sigmas[name] for name, value in away.items()), away


def test_priors_scale_with_the_corner() -> None:
    prior = LensPrior.of("ptz", STATED)
    assert prior.k1 * corner_radius(STATED) ** 2 == pytest.approx(0.1)
    assert LensPrior.of("ptz", STATED.zoomed(2.0)).k1 == pytest.approx(4 * prior.k1)
    with pytest.raises(PoseError, match="fisheye"):
        LensPrior.of("fisheye", STATED)
