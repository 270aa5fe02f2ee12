"""Compute what the terrain shows of itself from one place: the horizon all round, and the ridges below it.

Directions are (azimuth, tangent): the tangent of a point at height h and horizontal range r is that of the ray which
meets it, (h - z0) / r - bend r (`geodesy.ray_bend`). Along each azimuth the running maximum of the tangent is the
horizon; where ground comes into view again behind a hidden gap, its former maximum is a point of an occluding contour.
"""

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int32Array, Int64Array
from ltm_core.pose_estimation.skyline.picture_pose_config import BARE_EARTH, CrestCover
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_seam_kernels import bilinear
from ltm_core.tracing.possible_ground import PossibleGround

_MOST_RISE = 4.0  # maximum difference in tangent between neighbours of a contour, in steps of azimuth
_MOST_CHANGE = 0.12  # maximum difference in the logarithm of the range between neighbours of a contour
_SHORTEST = math.radians(0.6)  # minimum span of a contour in azimuth; shorter ones are single trees and noise


@dataclass(frozen=True, eq=False)
class OccludingContours:
    """Points of contours, (M,) each: `azimuth` (rad), `tangent`, `range` to the near side and the DEM's `cell` there,
    metres, and `following`: the index of the contour's next point in azimuth, -1 at its end."""

    azimuth: Float64Array
    tangent: Float64Array
    range: Float64Array
    cell: Float64Array
    following: Int64Array

    def __len__(self) -> int:
        return len(self.azimuth)


X_MIN, Y_MAX, RESOLUTION = 0, 1, 2  # columns of the geometry of rasters, finest first (metres)
TANGENT, RANGE, CELL, AT_EDGE, BOUND, FRONT_TANGENT, FRONT_RANGE = range(7)  # columns of a swept horizon, by azimuth


@kernel(nogil=True)
def _link(points: Float64Array, found: Int32Array, step: float) -> tuple[Int32Array, Int32Array]:
    """Of each point the one that follows it at the next azimuth, -1 without, and its contour's number of points."""
    count, most = points.shape[0], points.shape[1]
    following = np.full((count, most), -1, np.int32)
    length = np.zeros((count, most), np.int32)
    taken = np.full((count, most), -1, np.int32)
    for k in range(count - 1):
        for i in range(found[k]):
            best, least = -1, 1.0
            for j in range(found[k + 1]):
                rise = abs(points[k + 1, j, 0] - points[k, i, 0]) / (_MOST_RISE * step)
                change = abs(math.log(points[k + 1, j, 1] / points[k, i, 1])) / _MOST_CHANGE
                if taken[k + 1, j] < 0 and rise < 1.0 and change < 1.0 and rise + change < 2 * least:
                    best, least = j, (rise + change) / 2
            if best >= 0:
                following[k, i] = best
                taken[k + 1, best] = i
    for k in range(count):
        for i in range(found[k]):
            if taken[k, i] < 0:  # a contour begins
                n, a, b = 0, k, i
                while b >= 0:
                    n, a, b = n + 1, a + 1, following[a, b]
                a, b = k, i
                while b >= 0:
                    length[a, b] = n
                    a, b = a + 1, following[a, b]
    return following, length


_NEAREST = 20.0  # minimum range in metres; nearer, the DEM's error is as large as the shape of the ground
_FARTHEST = 80_000.0
_NEAREST_FRONT, _TREES = 120.0, 5.0
_MOST_CONTOURS = 24  # maximum number of points of occluding contours along one azimuth


@dataclass(frozen=True, eq=False)
class TerrainHorizon:
    """Horizon and occluding contours seen from `position`, every `step` radians of azimuth from `start` on.

    `tangent`, `range`: (N,) of the horizon, -inf and 0 where there is no known ground; `cell`: (N,) metres of the DEM
    there; `at_edge`: (N,) the DEM ends there, so that it is no crest. `bound`: (N,) the tangent above which there is
    certainly no ground, also none beyond the DEM; what lies between the two is open. `front_tangent`,
    `front_range`: (N,) of the nearer crest that trees of 5 m would raise highest, 0 where that is the horizon itself:
    trees on it, or haze, may hide the horizon. `cover`: of its crests."""

    position: Float64Array
    start: float
    step: float
    tangent: Float64Array
    range: Float64Array
    cell: Float64Array
    at_edge: BoolArray
    bound: Float64Array
    front_tangent: Float64Array
    front_range: Float64Array
    contours: OccludingContours
    cover: CrestCover = BARE_EARTH

    @property
    def azimuths(self) -> Float64Array:
        """Return (N,) radians, increasing."""
        return np.asarray(self.start + self.step * np.arange(len(self.tangent)), np.float64)

    @property
    def whole(self) -> bool:
        """Return whether the azimuths cover the full circle."""
        return len(self.tangent) * self.step > 2 * math.pi - 1.5 * self.step

    @property
    def open(self) -> BoolArray:
        """Return (N,) whether land beyond the DEM may rise above the horizon by over a hundredth of a degree."""
        return np.asarray(self.bound > self.tangent + 2e-4, np.bool_)


def terrain_horizon(
    dem: Dem,
    position: Float64Array,
    bend: float,
    possible: PossibleGround = PossibleGround(),
    azimuth: float = 0.0,
    half_width: float = math.pi,
    step: float = math.radians(0.04),
) -> TerrainHorizon:
    """Compute the horizon from `position` (3,), within `half_width` radians of `azimuth`. `bend`: of rays, 1/m.
    `possible`: heights of unknown ground. Raises PoseError if no DEM lies around the position."""
    count = math.ceil(2 * min(half_width, math.pi) / step)
    if half_width >= math.pi:
        step = 2 * math.pi / count
    start = azimuth - min(half_width, math.pi)
    levels = dem.levels
    geometry = np.array([[g.x_min, g.y_max, g.resolution] for g in (level.geometry for level in levels)])
    top = max(float(np.nanmax(level.elevation)) for level in levels)
    rows, points = np.empty((count, 7)), np.empty((count, _MOST_CONTOURS, 3))
    found = np.zeros(count, np.int32)
    elevations = tuple(level.elevation.view() for level in levels)
    for elevation in elevations:  # of one type for compiled code, whichever of them are shared
        elevation.flags.writeable = False
    place, beyond = np.array(position, np.float64), np.array([possible.steepest, possible.limit(top)])
    x, y = float(position[0]), float(position[1])
    x_min, y_min, x_max, y_max = levels[-1].geometry.bounds
    reach = min(_FARTHEST, math.hypot(max(x_max - x, x - x_min), max(y_max - y, y - y_min)))
    _sweep(elevations, geometry, place, bend, start, step, reach, beyond, rows, points, found)
    if not (rows[:, RANGE] > 0).any():
        covered = levels[-1].geometry.described()
        raise PoseError(
            f"no known terrain around ({x:.0f}, {y:.0f}), the DEM covers {covered}; check the camera's place"
        )
    tangent, rng, cell, at_edge, bound, front, front_range = rows.T.copy()
    # Contours that are long enough, linked from one azimuth to the next.
    following, length = _link(points, found, step)
    kept = (np.arange(points.shape[1]) < found[:, None]) & (length * step >= _SHORTEST)
    at, cols = np.nonzero(kept)
    number = np.full(kept.shape, -1, np.int64)
    number[at, cols] = np.arange(len(at))
    after = following[at, cols]
    linked = number[np.minimum(at + 1, count - 1), np.maximum(after, 0)]
    linked[(after < 0) | (at + 1 >= count)] = -1
    t, r, size = points[at, cols].T.copy()
    contours = OccludingContours(np.asarray(start + step * at, np.float64), t, r, size, linked)
    return TerrainHorizon(place, start, step, tangent, rng, cell, at_edge > 0, bound, front, front_range, contours)


@kernel(nogil=True)
def _sweep(
    levels: tuple[Float32Array, ...],
    geometry: Float64Array,
    position: Float64Array,
    bend: float,
    start: float,
    step: float,
    reach: float,
    possible: Float64Array,
    rows: Float64Array,
    points: Float64Array,
    found: Int32Array,
) -> None:
    """Fill the rows of the horizon, and the contour points (tangent, range, cell) of each azimuth and their count."""
    ox, oy, oz = position
    steepest, limit = possible
    most = points.shape[1]
    for k in range(len(rows)):
        azimuth = start + step * k
        sx, sy = math.sin(azimuth), math.cos(azimuth)
        highest, at, at_cell = -math.inf, 0.0, 0.0
        last_r, last_h = 0.0, math.nan
        raised, raised_at, raised_t = -math.inf, 0.0, 0.0
        hidden = False
        n = 0
        r = _NEAREST
        # Outwards along the azimuth: the horizon so far, and a contour where ground comes into view again.
        while r < reach:
            x, y = ox + r * sx, oy + r * sy
            h, size = math.nan, geometry[len(geometry) - 1, RESOLUTION]
            for i in range(len(levels)):
                col = (x - geometry[i, X_MIN]) / geometry[i, RESOLUTION] - 0.5
                row = (geometry[i, Y_MAX] - y) / geometry[i, RESOLUTION] - 0.5
                elevation = levels[i]
                if row >= 0.0 and col >= 0.0 and row <= elevation.shape[0] - 1 and col <= elevation.shape[1] - 1:
                    h, size = bilinear(elevation, row, col), geometry[i, RESOLUTION]
                    break
            if h == h:
                last_r, last_h = r, h
                t = (h - oz) / r - bend * r
                if r > _NEAREST_FRONT and t + _TREES / r > raised:
                    raised, raised_at, raised_t = t + _TREES / r, r, t
                if t > highest:
                    if hidden and r > 1.08 * at and r - at > 5 * at_cell and n < most:
                        points[k, n, 0], points[k, n, 1], points[k, n, 2] = highest, at, at_cell
                        n += 1
                    highest, at, at_cell = t, r, size
                    hidden = False
                else:
                    hidden = True
            r += max(0.6 * size, 0.0008 * r)
        rows[k, TANGENT], rows[k, RANGE], rows[k, CELL] = highest, at, at_cell
        rows[k, AT_EDGE] = 1.0 if last_r - at < 3 * at_cell + 0.005 * at else 0.0
        found[k] = n
        rows[k, FRONT_TANGENT], rows[k, FRONT_RANGE] = raised_t, raised_at if raised_at < 0.8 * at else 0.0
        # The highest that land beyond the last known ground may reach.
        top = -math.inf
        if last_r > 0.0 and limit > -1e3:
            r = last_r
            while r < 2e5:
                h = min(last_h + steepest * (r - last_r), limit)
                top = max(top, (h - oz) / r - bend * r)
                r += max(30.0, 0.02 * r)
        rows[k, BOUND] = max(top, highest)
