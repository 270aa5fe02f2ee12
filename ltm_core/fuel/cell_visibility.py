"""Visibility of each fuel cell in a frame: pixel footprint, angle of incidence, and uncertainty of the traced
position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, checked_covariance
from ltm_core.raster.dem import Dem
from ltm_core.visibility.footprint import arrival_directions

_LEAST_FACING = 0.02
"""Sine of about 1 degree, the flattest line of sight; flatter ones would give infinities to first order."""


@dataclass(frozen=True, eq=False)
class CellVisibility:
    """Visibility of cells, (N,) float32 each.

    `cos_incidence`: of the angle between sight and the ground's normal; 0 along the ground and where it is not known.
    `footprint`: metres of ground, away from the camera, that one pixel covers. `sigma_along`, `sigma_across`: metres
    by which the pose's uncertainty may misplace the cell on the map, away from the camera and sideways. `bearing`:
    radians clockwise from grid north from the camera to the cell.
    """

    cos_incidence: Float32Array
    footprint: Float32Array
    sigma_along: Float32Array
    sigma_across: Float32Array
    bearing: Float32Array

    def __post_init__(self) -> None:
        lengths = [np.shape(column) for column in self.columns()]
        if len(set(lengths)) != 1 or len(lengths[0]) != 1:
            raise ImageError(f"the columns of a cell visibility differ in shape: {lengths}")

    def columns(self) -> tuple[Float32Array, ...]:
        return self.cos_incidence, self.footprint, self.sigma_along, self.sigma_across, self.bearing

    def placement(self, cell: float) -> Float64Array:
        """Return the weight in (0, 1] of a cell of `cell` metres; 1 for a frame that resolves it and views it
        perpendicularly. It is the share of the cell in the area over which one pixel's vote may lie."""
        along = np.hypot(self.footprint, self.sigma_along).astype(np.float64)
        return np.asarray(cell / np.hypot(cell, along) * (cell / np.hypot(cell, self.sigma_across)), np.float64)

    def only(self, chosen: NDArray[Any]) -> CellVisibility:
        return CellVisibility(*(column[chosen] for column in self.columns()))

    def __len__(self) -> int:
        return len(self.bearing)


def cell_visibility(
    x: Float64Array,
    y: Float64Array,
    dem: Dem,
    cell: float,
    camera: Camera,
    pose: Pose,
    bend: float = 0.0,
    covariance: ArrayLike | None = None,
) -> CellVisibility:
    """Return how a camera sees the ground at map points (N,), with its slope taken over the width of a cell.

    To first order, on the ground's plane at each point: with the ray arriving along the unit vector d, the ground's
    normal n and p the way from camera to point, a camera moved by o and turned by w moves the ray's end by
    q = o + w x p, and the traced point by q - d (n.q) / (n.d). Source: forward propagation, e.g. Luhmann et al.,
    Close-Range Photogrammetry, 3rd ed., 2.4.3. Raises PoseError for a covariance that is none.
    """
    ground = np.column_stack([x, y, dem.elevation_at(x, y)])
    if len(ground) == 0:
        return CellVisibility(*(np.zeros(0, np.float32) for _ in range(5)))
    normals = _normals(dem, x, y, cell / 2)
    known = np.isfinite(ground[:, 2]) & np.isfinite(normals[:, 0])
    ground[~known, 2] = pose.position[2]
    normals[~known] = (0.0, 0.0, 1.0)
    arriving = arrival_directions(pose.position, ground, bend)
    lever = ground - pose.position
    facing = -np.einsum("ni,ni->n", normals, arriving)
    cosine = np.where(known, np.clip(facing, 0.0, 1.0), 0.0)
    facing = np.maximum(facing, _LEAST_FACING)
    distance = np.linalg.norm(lever, axis=1)
    footprint = distance / (min(camera.fx, camera.fy) * facing)
    bearing = np.arctan2(lever[:, 0], lever[:, 1])
    along, across = _sigmas(arriving, lever, normals, facing, bearing, covariance)
    return CellVisibility(*(np.asarray(c, np.float32) for c in (cosine, footprint, along, across, bearing)))


def _normals(dem: Dem, x: Float64Array, y: Float64Array, half: float) -> Float64Array:
    """Return the upward unit normals (N, 3) of the ground over `half` metres each way; NaN where a height is
    unknown."""
    east = (dem.elevation_at(x + half, y) - dem.elevation_at(x - half, y)) / (2 * half)
    north = (dem.elevation_at(x, y + half) - dem.elevation_at(x, y - half)) / (2 * half)
    length = np.sqrt(1 + east**2 + north**2)
    return np.column_stack([-east / length, -north / length, 1 / length])


def _sigmas(
    arriving: Float64Array,
    lever: Float64Array,
    normals: Float64Array,
    facing: Float64Array,
    bearing: Float64Array,
    covariance: ArrayLike | None,
) -> tuple[Float64Array, Float64Array]:
    """Return the horizontal sigmas of the traced points, away from the camera and sideways, metres."""
    if covariance is None:
        return np.zeros(len(lever)), np.zeros(len(lever))
    matrix = checked_covariance(covariance)
    sigmas = []
    for level in ((np.sin(bearing), np.cos(bearing)), (np.cos(bearing), -np.sin(bearing))):
        # The component h.(q - d (n.q) / (n.d)) of a level direction h is g.q with g = h + n (h.d) / facing.
        slope = (level[0] * arriving[:, 0] + level[1] * arriving[:, 1]) / facing
        g = normals * slope[:, None]
        g[:, 0] += level[0]
        g[:, 1] += level[1]
        row = np.concatenate([g, np.cross(lever, g)], axis=1)
        sigmas.append(np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", row, matrix, row), 0)))
    return sigmas[0], sigmas[1]
