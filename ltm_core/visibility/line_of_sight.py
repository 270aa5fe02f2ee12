"""Lines of sight under earth curvature and refraction: the ray that meets a map point, and rays through pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.camera import Camera
from ltm_core.types import Float64Array


def line_of_sight_vectors(origin: ArrayLike, points: ArrayLike, bend: float) -> Float64Array:
    """The directions, at the camera, of the rays that meet the points: (..., 3), metres, map axes.

    A ray of slope s stands at z0 + s r + bend r^2 over horizontal range r (`geodesy.ray_bend`), so a point seems lower
    than it is by bend r^2. The vector's horizontal part is the point's true offset; its length is the ray's slant
    range.

    Args:
        origin: (3,) the camera's position.
        points: (..., 3) map coordinates.
        bend: curvature coefficient, 1/m.
    """
    vectors = np.array(points, np.float64) - np.asarray(origin, np.float64)
    vectors[..., 2] -= bend * (vectors[..., 0] ** 2 + vectors[..., 1] ** 2)
    return vectors


def pixel_rays(camera: Camera, pixels: ArrayLike) -> Float64Array:
    """Unit viewing rays, optical frame, through the sub-pixel places (u, v): (N, 3) from (N, 2).

    NaN where the distortion cannot be inverted, as in `Camera.rays`.
    """
    rays = np.empty((len(np.asarray(pixels)), 3))
    for ray, (u, v) in zip(rays, np.asarray(pixels, np.float64), strict=True):
        # A camera of one pixel, shifted so that this pixel is the place asked for, shares the one inversion there is.
        one = Camera(1, 1, camera.fx, camera.fy, camera.cx - u, camera.cy - v, camera.distortion)
        ray[:] = one.rays()[0, 0]
    return rays
