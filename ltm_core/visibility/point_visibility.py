"""Project map points into an image and test whether terrain hides them."""

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
from ltm_core.tracing.raster_stages import grounds, stages
from ltm_core.visibility.footprint import line_of_sight_vectors
from ltm_core.visibility.occlusion_kernels import BEYOND, BY_CEILING, OVER_KNOWN, raise_slopes

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
        self, dem: Dem, curvature: bool = True, refraction: float = 0.13, possible: PossibleGround = PossibleGround()
    ) -> None:
        self.dem = dem
        self.bend = ray_bend(curvature, refraction)
        self._grounds, highest = grounds(dem, possible)
        self._beyond = possible.steepest, highest

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
