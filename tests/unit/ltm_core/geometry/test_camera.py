import math

import numpy as np
import pytest

from ltm_core.base.errors import CameraError
from ltm_core.geometry.camera import Camera

pytestmark = pytest.mark.kernel

BARREL = Camera(64, 40, 40.0, 42.0, 30.0, 21.0, (-0.3, 0.0, 0.0, 0.0, 0.0))


def test_from_fov_spans_the_outer_edges() -> None:
    camera = Camera.from_fov(8, 6, 90.0)
    assert (camera.fx, camera.fy) == (pytest.approx(4.0), pytest.approx(4.0))
    assert (camera.cx, camera.cy) == (3.5, 2.5)
    assert camera.hfov_deg == pytest.approx(90.0)
    assert Camera(9, 5, 20.0, 20.0, 1.0, 2.0).hfov_deg == pytest.approx(
        math.degrees(math.atan(1.5 / 20) + math.atan(7.5 / 20))
    )


def test_rays_are_shared_and_so_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Camera(5, 3, 2.0, 4.0, 1.0, 2.0).rays()[0, 0, 0] = 1.0


def test_project() -> None:
    camera = Camera(5, 3, 2.0, 4.0, 1.0, 2.0)
    np.testing.assert_allclose(camera.project(np.array([3.0, -1.5, 3.0])), [3.0, 0.0])
    behind = camera.project(np.array([[1.0, 1.0, -2.0], [0.5, 0.0, 0.0], [0.0, 0.0, 2.0]]))
    assert np.isnan(behind[:2]).all()
    assert behind[2].tolist() == [1.0, 2.0]


def test_no_ray_beyond_the_fold() -> None:
    # r (1 - 0.3 r^2) grows up to r = sqrt(1 / 0.9), where it is two thirds of that.
    fold = math.sqrt(1 / 0.9)
    camera = Camera(201, 3, 100.0, 100.0, 100.0, 1.0, (-0.3, 0.0, 0.0, 0.0, 0.0))
    x = (np.arange(201) - 100) / 100
    known = np.isfinite(camera.rays()[1, :, 0])
    assert known.any()
    assert not known.all()
    np.testing.assert_array_equal(known, np.abs(x) < fold * 2 / 3)
    assert np.isfinite(camera.project(np.array([0.999 * fold, 0.0, 1.0]))).all()
    assert np.isnan(camera.project(np.array([1.001 * fold, 0.0, 1.0]))).all()


def test_resized_shows_the_same_from_edge_to_edge() -> None:
    small = BARREL.resized(31, 17)
    rays = BARREL.rays()[::9, ::7].reshape(-1, 3)
    u, v = np.meshgrid(np.arange(0, BARREL.width, 7), np.arange(0, BARREL.height, 9))
    across, down = 31 / BARREL.width, 17 / BARREL.height
    expected = np.stack([(u.ravel() + 0.5) * across - 0.5, (v.ravel() + 0.5) * down - 0.5], axis=-1)
    seen = np.isfinite(rays).all(axis=-1)
    assert seen.mean() > 0.5
    np.testing.assert_allclose(small.project(rays[seen]), expected[seen], atol=1e-6)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0, 40, 40.0, 40.0, 1.0, 1.0), "0 x 40"),
        ((64, 40, 0.0, 40.0, 1.0, 1.0), "fx=0.0"),
        ((64, 40, 40.0, -3.0, 1.0, 1.0), "fy=-3.0"),
        ((64, 40, 40.0, 40.0, float("nan"), 1.0), "finite"),
        ((64, 40, 40.0, 40.0, 1.0, 1.0, (0.0, 0.0, 0.0, 0.0, float("inf"))), "finite"),
        ((64, 40, 40.0, 40.0, 1.0, 1.0, (0.1, 0.2)), "k1, k2, p1, p2, k3"),
        ((64, 40, 40.0, 40.0, 1.0, 1.0, (0.1, 1e300, 0.0, 0.0, 0.0)), "not that of a lens"),
    ],
)
def test_no_camera(values: tuple, message: str) -> None:
    with pytest.raises(CameraError, match=message):
        Camera(*values)


def test_scaled_needs_a_step() -> None:
    with pytest.raises(CameraError, match="got 0"):
        BARREL.scaled(0)


@pytest.mark.parametrize("hfov_deg", [0.0, 180.0, -5.0, float("nan")])
def test_no_field_of_view(hfov_deg: float) -> None:
    with pytest.raises(CameraError, match="field of view"):
        Camera.from_fov(64, 40, hfov_deg)
