"""Compute the ground patch that a pixel covers, and the uncertainty of its traced point.

Uncertainty of traced points: propagation of the pose covariance to the ground, and the pixel's footprint.

First order, on the ground's plane at each traced point. With the ray arriving along the unit vector d, the ground's
normal n, and p the way from camera to point, a camera moved by o and turned by the small rotation w moves the ray's end
by q = o + w x p, and the traced point by q - d (n.q) / (n.d). Source: forward propagation, e.g. Luhmann et al.,
Close-Range Photogrammetry, 3rd ed., 2.4.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import PoseError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem
from ltm_core.visibility.point_visibility import line_of_sight_vectors


@dataclass(frozen=True, eq=False)
class Footprints:
    """`along`, `across`: (N,) metres, extents of a pixel's parallelogram on the ground, away from the camera and
    sideways; +inf where the ground faces away, NaN where it is not known. `area`: (N,) square metres.
    """

    along: Float64Array
    across: Float64Array
    area: Float64Array


def ground_normals(dem: Dem, x: Float64Array, y: Float64Array) -> Float64Array:
    """Upward unit normals (..., 3) of the ground at map points, from height differences over one cell, or over half of
    one where the other half is unknown; NaN where neither is known.
    """
    half = dem.geometry.resolution / 2
    here = dem.elevation_at(x, y)
    east = _slope(dem.elevation_at(x - half, y), here, dem.elevation_at(x + half, y), half)
    north = _slope(dem.elevation_at(x, y - half), here, dem.elevation_at(x, y + half), half)
    normals = np.stack([-east, -north, np.ones_like(east)], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True), np.float64)


def _slope(before: Float64Array, here: Float64Array, after: Float64Array, step: float) -> Float64Array:
    whole = (after - before) / (2 * step)
    half = np.where(np.isnan(after), here - before, after - here) / step
    return np.where(np.isnan(whole), half, whole)


def arrival_directions(position: Float64Array, points: Float64Array, bend: float) -> Float64Array:
    """Unit directions (..., 3) in which rays from `position` arrive at the points, bent by curvature."""
    arriving = line_of_sight_vectors(position, points, bend)
    arriving[..., 2] += 2 * bend * (arriving[..., 0] ** 2 + arriving[..., 1] ** 2)
    return np.asarray(arriving / np.linalg.norm(arriving, axis=-1, keepdims=True), np.float64)


def sideways(directions: Float64Array) -> Float64Array:
    """Unit horizontal vectors (..., 3) to the right of the directions; of a plumb one, east."""
    right = np.stack([directions[..., 1], -directions[..., 0], np.zeros_like(directions[..., 0])], axis=-1)
    length = np.linalg.norm(right, axis=-1, keepdims=True)
    plumb = length[..., 0] < 1e-9
    with np.errstate(invalid="ignore"):
        right = right / length
    right[plumb] = (1.0, 0.0, 0.0)
    return np.asarray(right, np.float64)


def ground_footprints(
    camera: Camera, pose: Pose, points: Float64Array, normals: Float64Array, bend: float
) -> Footprints:
    """Footprints of the pixels that see the ground points (N, 3) with upward normals (N, 3).

    To first order: the inverse of the projection's Jacobian over the plane at each point, distortion included.
    """
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
        along = (np.abs(per_b[:, 0]) + np.abs(per_b[:, 1])) / determinant
        across = (np.abs(per_a[:, 0]) + np.abs(per_a[:, 1])) / determinant
        area = 1 / determinant
    away = np.sum(arriving * normals, axis=-1) >= 0
    for values in (along, across, area):
        values[away & ~np.isnan(values)] = np.inf
    return Footprints(along, across, area)


GRAZING_DEG = 2.0
"""Between ray and ground: below it the first order no longer holds, and the point may jump to other ground."""
_ROWS = 64


@dataclass(frozen=True, eq=False)
class TracedUncertainty:
    """Per pixel, (H, W); NaN where the pixel sees no terrain or its slope is not known.

    `along`: float32 sigma of the traced point along the ray, metres: of its range. `across`: sideways, level. `over`:
    square to both. Along, across and over are at right angles, so `total` is their root sum of squares.
    `footprint_along`, `footprint_across`: metres of ground that the pixel covers, away from the camera and sideways.
    `grazing`: bool, the ray meets the ground at less than the limit: along (and the footprint along) are then lower
    bounds of what can go wrong, and +inf where the ground's plane faces away.
    """

    along: Float32Array
    across: Float32Array
    over: Float32Array
    footprint_along: Float32Array
    footprint_across: Float32Array
    grazing: BoolArray

    @property
    def total(self) -> Float32Array:
        squares = self.along.astype(np.float64) ** 2 + self.across.astype(np.float64) ** 2
        total: Float32Array = np.sqrt(squares + self.over.astype(np.float64) ** 2).astype(np.float32)
        return total


def traced_uncertainty(
    traced: RangeImage,
    dem: Dem,
    covariance: ArrayLike,
    dem_sigma: float = 0.0,
    grazing_deg: float = GRAZING_DEG,
) -> TracedUncertainty:
    """Sigmas and footprints of a traced image.

    Args:
        traced: what `TerrainTracer.trace` gave over `dem`.
        covariance: (6, 6) of the pose over x, y, z (m) and small rotations about the map's x, y, z (rad), as in
            geometry_msgs/PoseWithCovariance and `Resection.pose_covariance`.
        dem_sigma: of the DEM's heights, metres; it moves points along their rays.
        grazing_deg: angle between ray and ground below which a pixel is marked grazing.

    Raises PoseError for a covariance that is none.
    """
    matrix = checked_covariance(covariance)
    if not dem_sigma >= 0:
        raise PoseError(f"the sigma of the DEM's heights must be 0 or more metres, got {dem_sigma}")
    shape = traced.range.shape
    along, across, over, print_along, print_across = (np.full(shape, np.nan, np.float32) for _ in range(5))
    layers = (along, across, over, print_along, print_across)
    grazing = np.zeros(shape, np.bool_)
    points = traced.points()
    limit = float(np.sin(np.radians(grazing_deg)))
    for start in range(0, shape[0], _ROWS):
        rows = slice(start, start + _ROWS)
        seen = np.isfinite(points[rows, :, 0])
        places = points[rows][seen].astype(np.float64)
        if not len(places):
            continue
        normals = ground_normals(dem, places[:, 0], places[:, 1])
        values, facing = _propagated(traced, places, normals, matrix, dem_sigma)
        prints = ground_footprints(traced.camera, traced.pose, places, normals, traced.bend)
        for layer, column in zip(layers, (*values, prints.along, prints.across), strict=True):
            layer[rows][seen] = column
        grazing[rows][seen] = facing < limit
    return TracedUncertainty(along, across, over, print_along, print_across, grazing)


def _propagated(
    traced: RangeImage, places: Float64Array, normals: Float64Array, covariance: Float64Array, dem_sigma: float
) -> tuple[tuple[Float64Array, Float64Array, Float64Array], Float64Array]:
    """Sigmas along, across and over, and the sine of the angle between ray and ground, (N,) each."""
    position = traced.pose.position
    arriving = arrival_directions(position, places, traced.bend)
    across = sideways(arriving)
    over = np.cross(across, arriving)
    lever = places - position
    facing = -np.sum(normals * arriving, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = arriving + normals / facing[:, None]
        ground = dem_sigma * normals[:, 2] / facing
    sigmas = []
    # A component g.(o + w x p) is the row [g, p x g] times (o, w).
    for component in (along, across, over):
        row = np.concatenate([component, np.cross(lever, component)], axis=-1)
        sigmas.append(np.einsum("ni,ij,nj->n", row, covariance, row))
    sigmas[0] = np.where(facing > 0, sigmas[0] + ground**2, np.where(np.isnan(facing), np.nan, np.inf))
    first, second, third = (np.sqrt(np.maximum(variance, 0)) for variance in sigmas)
    unknown = np.isnan(facing)
    second[unknown] = third[unknown] = np.nan
    return (first, second, third), facing


def checked_covariance(covariance: ArrayLike) -> Float64Array:
    """The covariance of a pose as a (6, 6) matrix. Raises PoseError for one that is none."""
    matrix = np.asarray(covariance, np.float64)
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all():
        raise PoseError(f"a pose covariance must be a finite 6 x 6 matrix, got {matrix.tolist()}")
    size = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > 1e-6 * size or np.linalg.eigvalsh(matrix).min() < -1e-9 * size:
        raise PoseError(f"a pose covariance must be symmetric without negative variances, got {matrix.tolist()}")
    return matrix
