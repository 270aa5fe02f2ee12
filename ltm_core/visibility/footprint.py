"""Compute the rays that meet map points, and the ground patch that a pixel covers."""

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem


def ground_normals(dem: Dem, x: Float64Array, y: Float64Array, half: float) -> Float64Array:
    """Return the upward unit normals (..., 3) of the ground over `half` metres each way, or one way where the ground is
    unknown the other; NaN where neither is known."""
    here = dem.elevation_at(x, y)

    def slope(before: Float64Array, after: Float64Array) -> Float64Array:
        one_way = np.where(np.isnan(after), here - before, after - here) / half
        return np.where(np.isnan(after - before), one_way, (after - before) / (2 * half))

    east = slope(dem.elevation_at(x - half, y), dem.elevation_at(x + half, y))
    north = slope(dem.elevation_at(x, y - half), dem.elevation_at(x, y + half))
    length = np.sqrt(1 + east**2 + north**2)
    return np.stack([-east / length, -north / length, 1 / length], axis=-1)


def arrival_directions(position: Float64Array, points: Float64Array, bend: float) -> Float64Array:
    """Return the unit directions (..., 3) in which rays from `position` arrive at the points, bent by curvature."""
    arriving = line_of_sight_vectors(position, points, bend)
    arriving[..., 2] += 2 * bend * (arriving[..., 0] ** 2 + arriving[..., 1] ** 2)
    return np.asarray(arriving / np.linalg.norm(arriving, axis=-1, keepdims=True), np.float64)


def sideways(directions: Float64Array) -> Float64Array:
    """Return the unit horizontal vectors (..., 3) to the right of the directions; of a plumb one, east."""
    right = np.stack([directions[..., 1], -directions[..., 0], np.zeros_like(directions[..., 0])], axis=-1)
    length = np.linalg.norm(right, axis=-1, keepdims=True)
    plumb = length[..., 0] < 1e-9
    with np.errstate(invalid="ignore"):
        right = right / length
    right[plumb] = (1.0, 0.0, 0.0)
    return np.asarray(right, np.float64)


def ground_footprints(
    camera: Camera, pose: Pose, points: Float64Array, normals: Float64Array, bend: float
) -> Float64Array:
    """Return the longer extent, (N,) metres, away from the camera or sideways, of the pixels that see the ground points
    (N, 3) with upward normals (N, 3): by the inverse of the projection's Jacobian over the plane at each point. +inf if
    the ground faces away, NaN if it is not known."""
    arriving = arrival_directions(pose.position, points, bend)
    # Axes in the ground's plane: b sideways, a away from the camera.
    b = sideways(arriving)
    b = b - normals * np.sum(b * normals, axis=-1, keepdims=True)
    b /= np.linalg.norm(b, axis=-1, keepdims=True)
    a = np.cross(normals, b)
    step = 1e-4 * np.linalg.norm(points - pose.position, axis=-1, keepdims=True)

    def pixels(moved: Float64Array) -> Float64Array:
        return camera.project(line_of_sight_vectors(pose.position, moved, bend) @ pose.rotation)

    per_a = (pixels(points + step * a) - pixels(points - step * a)) / (2 * step)
    per_b = (pixels(points + step * b) - pixels(points - step * b)) / (2 * step)
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = np.abs(per_a[:, 0] * per_b[:, 1] - per_a[:, 1] * per_b[:, 0])
        longer = np.maximum(np.abs(per_a).sum(axis=1), np.abs(per_b).sum(axis=1)) / determinant
    longer[(np.sum(arriving * normals, axis=-1) >= 0) & ~np.isnan(longer)] = np.inf
    return np.asarray(longer, np.float64)


def line_of_sight_vectors(origin: ArrayLike, points: ArrayLike, bend: float) -> Float64Array:
    """Return the directions, at the camera `origin` (3,), of the rays that meet the points: (..., 3), metres, map axes.

    A ray of slope s has the height z0 + s r + bend r^2 (`geodesy.ray_bend`), so a point seems lower than it is by bend
    r^2. The vector's horizontal part is the point's true offset; its length is the ray's slant range."""
    vectors = np.array(points, np.float64) - np.asarray(origin, np.float64)
    vectors[..., 2] -= bend * (vectors[..., 0] ** 2 + vectors[..., 1] ** 2)
    return vectors


def pixel_rays(camera: Camera, pixels: ArrayLike) -> Float64Array:
    """Return the unit viewing rays, optical frame, through the sub-pixel places (u, v): (N, 3) from (N, 2); NaN where
    the distortion cannot be inverted."""
    rays = np.empty((len(np.asarray(pixels)), 3))
    for ray, (u, v) in zip(rays, np.asarray(pixels, np.float64), strict=True):
        # A camera of one pixel, shifted so that this pixel is the place asked for, shares the one inversion there is.
        one = Camera(1, 1, camera.fx, camera.fy, camera.cx - u, camera.cy - v, camera.distortion)
        ray[:] = one.rays()[0, 0]
    return rays
