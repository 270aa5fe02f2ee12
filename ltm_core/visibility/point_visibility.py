"""Measure which points cameras see, and the ground that a pixel covers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import PoseError
from ltm_core.base.kernels import in_parallel
from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing.possible_ground import PossibleGround
from ltm_core.tracing.raster_stages import grounds, highest_possible, stages
from ltm_core.visibility.occlusion_kernels import BEYOND, BY_CEILING, OVER_KNOWN, raise_slopes


@dataclass(frozen=True, eq=False)
class Footprints:
    """`along`, `across`: (N,) metres, extents of a pixel's parallelogram on the ground, away from the camera and
    sideways; +inf where the ground faces away, NaN where it is not known. `area`: (N,) square metres."""

    along: Float64Array
    across: Float64Array
    area: Float64Array


def ground_normals(dem: Dem, x: Float64Array, y: Float64Array) -> Float64Array:
    """Return the upward unit normals (..., 3) of the ground at map points, from height differences over one cell, or
    over half of one where the other half is unknown; NaN where neither is known."""
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
) -> Footprints:
    """Return the footprints of the pixels that see the ground points (N, 3) with upward normals (N, 3), by the inverse
    of the projection's Jacobian over the plane at each point."""
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


TOLERANCE = 0.01
"""Metres by which a point may be too low and still count as visible, because a point on the ground is never exactly on
it."""
_CHUNK = 4096


class PointState(IntEnum):
    VISIBLE = 0
    HIDDEN = 1
    """Known terrain is in front of the point."""
    OUTSIDE = 2
    """The point is outside the image."""
    UNKNOWN = 3
    """The point is in the image and not hidden by known terrain, but behind or over ground that the DEM does not cover.
    """


@dataclass(frozen=True, eq=False)
class Visibility:
    """Map points in an image.

    `pixels`: (N, 2) u, v; NaN behind the camera. `states`: (N,) uint8 `PointState`. `lifts`: (N,) float64 metres by
    which each point must be raised, plumb, for the terrain to show it: 0 where nothing is in the way; the image's
    edges do not matter for it."""

    pixels: Float64Array
    states: UInt8Array
    lifts: Float64Array

    @property
    def visible(self) -> BoolArray:
        return np.asarray(self.states == PointState.VISIBLE)


class PointVisibility:
    """Lines of sight over one DEM, in the frame of the points. Surface, rays, holes and arguments are those of
    `tracing.TerrainTracer`; so is the memory. Raises RasterError for a DEM with infinite heights."""

    def __init__(
        self,
        dem: Dem,
        curvature: bool = True,
        refraction: float = 0.13,
        possible: PossibleGround = PossibleGround(),
    ) -> None:
        self.dem = dem
        self.bend = ray_bend(curvature, refraction)
        self._grounds = grounds(dem, possible)
        self._beyond = possible.steepest, highest_possible(dem, possible)

    def lifts(self, origin: ArrayLike, points: ArrayLike) -> tuple[Float64Array, BoolArray]:
        """Return the lift that makes points visible from `origin`, (N,) metres, 0 if they are visible; and whether it
        depends on unknown ground: a hole's ceiling, or beyond the DEM. Raises PoseError if the origin is under the
        ground or not finite."""
        position, targets = np.asarray(origin, np.float64), np.asarray(points, np.float64)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise PoseError(f"camera position must be three finite metres, got {position.tolist()}")
        if targets.ndim != 2 or targets.shape[1] != 3:
            raise PoseError(f"points must be (N, 3) map coordinates, got {targets.shape}")
        clearance = float(position[2] - self.dem.elevation_at(position[0], position[1]))
        if clearance <= 0:
            raise PoseError(f"camera at {position.tolist()} is {-clearance:.2f} m under the ground; check its height")
        across = np.hypot(targets[:, 0] - position[0], targets[:, 1] - position[1])
        plumb = across < 1e-6
        with np.errstate(divide="ignore", invalid="ignore"):
            own = np.where(plumb, 0.0, (targets[:, 2] - position[2]) / across - self.bend * across)
        own[~np.isfinite(own)] = np.nan
        slopes, came_to = own.copy(), np.zeros(len(targets), np.uint8)
        passed = stages(self.dem, position, self.bend, *self._beyond)

        def work(start: int, end: int) -> None:
            part = slice(start, end)
            for number, (level, stage) in enumerate(passed):
                rows, cols = self.dem.levels[level].geometry.to_grid(targets[part, 0], targets[part, 1])
                in_grid = np.column_stack([cols, rows, targets[part, 2]])
                raise_slopes(self._grounds[level], stage, number == 0, in_grid, slopes[part], came_to[part])

        in_parallel(work, len(targets), _CHUNK)
        lift = np.where(plumb, slopes, (slopes - own) * across)
        nothing_known = (slopes <= own) & ((came_to & BEYOND > 0) | (came_to & OVER_KNOWN == 0))
        nothing_known[plumb] = came_to[plumb] & OVER_KNOWN == 0
        return lift, (came_to & BY_CEILING > 0) | nothing_known | np.isnan(slopes)

    def visible(self, camera: Camera, pose: Pose, points: ArrayLike, tolerance: float = TOLERANCE) -> Visibility:
        """Return the pixels and states of map points (N, 3). A point is visible when raising it by `tolerance` metres
        shows it."""
        targets = np.asarray(points, np.float64)
        lift, unknown = self.lifts(pose.position, targets)
        pixels = project(camera, pose, targets, self.bend)
        states = np.where(lift > tolerance, PointState.HIDDEN, PointState.VISIBLE).astype(np.uint8)
        states[unknown] = PointState.UNKNOWN
        states[~in_image(camera, pixels)] = PointState.OUTSIDE
        return Visibility(pixels, states, lift)


def project(camera: Camera, pose: Pose, points: ArrayLike, bend: float) -> Float64Array:
    """Return the pixels (..., 2) of map points (..., 3) under curvature and refraction; NaN behind the camera."""
    return camera.project(line_of_sight_vectors(pose.position, points, bend) @ pose.rotation)


def in_image(camera: Camera, pixels: Float64Array) -> BoolArray:
    """Return which places (..., 2) lie on the image, its outermost pixels' outer edges included; NaN does not."""
    u, v = pixels[..., 0], pixels[..., 1]
    inside = (u >= -0.5) & (v >= -0.5) & (u <= camera.width - 0.5) & (v <= camera.height - 0.5)
    return np.asarray(inside, np.bool_)
