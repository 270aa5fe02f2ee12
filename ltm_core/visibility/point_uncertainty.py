"""Uncertainty of traced points: propagation of the pose covariance to the ground, and the pixel's footprint.

First order, on the ground's plane at each traced point. With the ray arriving along the unit vector d, the ground's
normal n, and p the way from camera to point, a camera moved by o and turned by the small rotation w moves the ray's end
by q = o + w x p, and the traced point by q - d (n.q) / (n.d). Source: forward propagation, e.g. Luhmann et al.,
Close-Range Photogrammetry, 3rd ed., 2.4.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.dem import Dem
from ltm_core.errors import PoseError
from ltm_core.range_image import RangeImage
from ltm_core.types import BoolArray, Float32Array, Float64Array
from ltm_core.visibility.footprint import arrival_directions, ground_footprints, ground_normals, sideways

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
