"""What must hold for any camera."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scenes.examples import examples

from ltm_core.geometry.camera import Camera

pytestmark = pytest.mark.kernel

coefficients = st.tuples(
    st.floats(-0.4, 0.4), st.floats(-0.2, 0.2), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.floats(-0.1, 0.1)
)
cameras = st.builds(
    Camera,
    st.integers(2, 40),
    st.integers(2, 30),
    st.floats(15, 200),
    st.floats(15, 200),
    st.floats(-5, 45),
    st.floats(-5, 35),
    coefficients,
)


@examples(60, in_fuzz=150)
@given(cameras)
def test_every_ray_projects_to_its_pixel(camera: Camera) -> None:
    rays = camera.rays()
    known = np.isfinite(rays).all(axis=-1)
    np.testing.assert_array_equal(known, np.isfinite(rays).any(axis=-1))
    np.testing.assert_allclose(np.linalg.norm(rays[known], axis=-1), 1.0, rtol=1e-12)
    v, u = np.indices(known.shape)
    np.testing.assert_allclose(camera.project(rays[known]), np.stack([u, v], axis=-1)[known], atol=1e-5)


@examples(60, in_fuzz=150)
@given(st.floats(-0.4, 0.4), st.floats(0, 0.2), st.floats(0.0, 0.9), st.floats(0, 2 * np.pi))
@example(0.0, 5e-324, 0.5, 1.0)
def test_a_pixel_that_something_projects_to_has_that_ray(k1: float, k2: float, share: float, angle: float) -> None:
    """`share`: of the radius up to which the radial model grows, or of 1."""
    discriminant = 9 * k1 * k1 - 20 * k2
    folds = k1 < 0 and discriminant > 0
    # 1 + 3 k1 s + 5 k2 s^2 = 0 in its stable form, so that k2 may be 0.
    fold = np.sqrt(2 / (-3 * k1 + np.sqrt(discriminant))) if folds else 1.0
    x, y = min(1.0, fold) * share * np.array([np.cos(angle), np.sin(angle)])
    lens = Camera(1, 1, 50.0, 60.0, 0.0, 0.0, (k1, k2, 0.0, 0.0, 0.0))
    u, v = lens.project(np.array([x, y, 1.0]))
    # The same lens, its one pixel where the point projects to.
    ray = Camera(1, 1, 50.0, 60.0, -float(u), -float(v), lens.distortion).rays()[0, 0]
    np.testing.assert_allclose(ray[:2] / ray[2], [x, y], atol=1e-8)


@examples(40, in_fuzz=60)
@given(cameras, st.integers(1, 12))
def test_a_sampled_image_has_the_rays_of_its_pixels(camera: Camera, step: int) -> None:
    rays = camera.rays()[::step, ::step]
    sampled = camera.scaled(step).rays()
    assert sampled.shape == rays.shape
    both = np.isfinite(rays) & np.isfinite(sampled)
    assert both.sum() >= np.isfinite(rays).sum() - 3  # rounding may decide for a pixel right on the fold
    np.testing.assert_allclose(sampled[both], rays[both], atol=1e-6)
