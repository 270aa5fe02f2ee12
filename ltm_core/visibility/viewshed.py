"""Viewshed of a network of cameras: how many see each ground cell, how finely, and from what height above ground."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import PoseError, RasterError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int16Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.visibility.footprint import arrival_directions, ground_footprints, ground_normals, line_of_sight_vectors
from ltm_core.visibility.point_visibility import TOLERANCE, PointVisibility, in_image, project

_CELLS = 1 << 18
"""Number of cells processed at a time, which bounds memory."""
_MOST_CELLS = 16_000_000
"""Maximum number of cells of a result if no resolution is given."""


@dataclass(frozen=True)
class PosedCamera:
    """One camera of a network, in the map frame."""

    name: str
    camera: Camera
    pose: Pose


@dataclass(frozen=True, eq=False)
class Coverage:
    """Rasters (H, W) over `geometry`.

    `count`: int16, cameras that see the cell at the target's height; -1 where the ground is not known. `footprint`:
    float32 metres, the longer side of a pixel's footprint on the cell's ground, of the camera that sees it best; NaN
    where none does, or only over a crest whose slope faces away. `height`: float32 metres above the
    ground, the least that some camera sees; NaN where no camera looks that way or unknown ground is before it."""

    geometry: GridGeometry
    count: Int16Array
    footprint: Float32Array
    height: Float32Array

    @property
    def known(self) -> int:
        return int((self.count >= 0).sum())

    def share(self, cameras: int = 1) -> float:
        """Return the share of the known ground that at least `cameras` cameras see."""
        return float((self.count >= cameras).sum() / max(1, self.known))


def viewshed(
    sight: PointVisibility,
    views: Sequence[PosedCamera],
    resolution: float | None = None,
    target_height: float = 0.0,
    max_range: float = math.inf,
    all_round: bool = False,
    ground: Dem | None = None,
) -> Coverage:
    """Return the coverage of the whole DEM by cameras, in the frame of the poses.

    `resolution`: of the result, metres; a cell is judged at its centre. Default: the DEM's, or the least multiple of it
    with at most 16 million cells. `target_height`: metres above the ground of the target (smoke, a person). `ground`:
    bare earth, from which heights count; None: the terrain of `sight`. Ground under trees counts as seen where their
    tops are. `max_range`: horizontal range of a camera in metres. `all_round`: cameras turn wherever needed. Raises
    PoseError: no camera, or one under the ground; RasterError for an invalid resolution."""
    if not views:
        raise PoseError("a viewshed needs at least one camera with calibration and pose")
    if not (math.isfinite(target_height) and target_height >= 0):
        raise PoseError(f"the target's height must be 0 or more metres above the ground, got {target_height}")
    bare = sight.dem if ground is None else ground
    geometry = _resampled(bare.geometry, resolution)
    count = np.full(geometry.shape, -1, np.int16)
    footprint = np.full(geometry.shape, np.inf, np.float32)
    height = np.full(geometry.shape, np.inf, np.float32)
    rows_at_once = max(1, _CELLS // geometry.width)
    for start in range(0, geometry.height, rows_at_once):
        rows = slice(start, min(start + rows_at_once, geometry.height))
        row, col = np.mgrid[rows, 0 : geometry.width]
        x, y = geometry.to_map(row, col)
        top = sight.dem.elevation_at(x, y)
        known = np.isfinite(top)
        if not known.any():
            continue
        places = np.stack([x, y, top], axis=-1)[known]
        canopy = np.zeros(len(places)) if ground is None else places[:, 2] - ground.elevation_at(x[known], y[known])
        canopy = np.maximum(np.nan_to_num(canopy), 0.0)
        target = np.maximum(target_height - canopy, 0.0)
        normals = ground_normals(sight.dem, places[:, 0], places[:, 1], sight.dem.geometry.resolution / 2)
        seen_by = np.zeros(len(places), np.int16)
        best, lowest = np.full(len(places), np.inf), np.full(len(places), np.inf)
        for view in views:
            seen, size, least = _from_one(sight, view, places, normals, target, max_range, all_round)
            seen_by += seen
            best = np.fmin(best, np.where(seen, size, np.inf))
            lowest = np.fmin(lowest, least + canopy)
        count[rows][known] = seen_by
        footprint[rows][known] = best
        height[rows][known] = lowest
    footprint[np.isinf(footprint)] = np.nan
    height[np.isinf(height)] = np.nan
    return Coverage(geometry, count, footprint, height)


def _from_one(
    sight: PointVisibility,
    view: PosedCamera,
    places: Float64Array,
    normals: Float64Array,
    targets: Float64Array,
    max_range: float,
    all_round: bool,
) -> tuple[BoolArray, Float64Array, Float64Array]:
    """Return whether one camera sees targets (N,) metres above `places` (N, 3), its footprints there (metres), and the
    least visible height above them (+inf where it sees none)."""
    position = view.pose.position
    near = np.hypot(places[:, 0] - position[0], places[:, 1] - position[1]) <= max_range
    looked = near if all_round else near & _may_be_framed(sight, view, places)
    lift = np.full(len(places), np.inf)
    unknown = np.ones(len(places), np.bool_)
    lift[looked], unknown[looked] = sight.lifts(position, places[looked])
    least = np.where(unknown, np.inf, np.where(lift <= TOLERANCE, 0.0, lift))
    seen = least <= targets
    if not all_round:
        seen &= _framed(sight, view, places, targets)
        least[~_framed(sight, view, places, np.where(np.isfinite(least), least, 0.0))] = np.inf
    size = np.full(len(places), np.inf)
    if all_round:
        size[seen] = _turned_footprint(view.camera, position, places[seen], normals[seen], sight.bend)
    else:
        size[seen] = ground_footprints(view.camera, view.pose, places[seen], normals[seen], sight.bend)
    return seen, size, least


def _may_be_framed(sight: PointVisibility, view: PosedCamera, places: Float64Array) -> BoolArray:
    """Return the cells in the sector that the image spans on the map, at any height: spares the others their line of
    sight."""
    forward = view.pose.rotation[:, 2]
    horizontal = float(np.hypot(forward[0], forward[1]))
    if horizontal < 0.5:  # looks steeply up or down
        return np.ones(len(places), np.bool_)
    ahead = (places[:, :2] - view.pose.position[:2]) @ forward[:2] / horizontal
    sideways = (places[:, :2] - view.pose.position[:2]) @ np.array([forward[1], -forward[0]]) / horizontal
    rays = view.camera.rays()
    corners = np.concatenate([rays[0], rays[-1], rays[:, 0], rays[:, -1]]) @ view.pose.rotation.T
    if np.isnan(corners).any() or (corners[:, :2] @ forward[:2] <= 1e-3).any():
        return np.ones(len(places), np.bool_)
    tangents = (corners[:, :2] @ np.array([forward[1], -forward[0]])) / (corners[:, :2] @ forward[:2])
    return np.asarray(
        (ahead > 0) & (sideways >= (tangents.min() - 0.01) * ahead) & (sideways <= (tangents.max() + 0.01) * ahead)
    )


def _framed(sight: PointVisibility, view: PosedCamera, places: Float64Array, above: Float64Array) -> BoolArray:
    raised = places.copy()
    raised[:, 2] += above
    return in_image(view.camera, project(view.camera, view.pose, raised, sight.bend))


def _turned_footprint(
    camera: Camera, position: Float64Array, places: Float64Array, normals: Float64Array, bend: float
) -> Float64Array:
    """Longer side of the footprint of a central pixel turned towards each place, metres."""
    distance = np.linalg.norm(line_of_sight_vectors(position, places, bend), axis=1)
    facing = -np.sum(arrival_directions(position, places, bend) * normals, axis=1)
    with np.errstate(divide="ignore"):
        along = np.where(facing > 0, distance / (camera.fy * facing), np.inf)
    return np.asarray(np.maximum(along, distance / camera.fx), np.float64)


def _resampled(geometry: GridGeometry, resolution: float | None) -> GridGeometry:
    if resolution is None:
        resolution = geometry.resolution * math.ceil(math.sqrt(geometry.width * geometry.height / _MOST_CELLS))
    if resolution == geometry.resolution:
        return geometry
    if not (math.isfinite(resolution) and resolution > 0):
        raise RasterError(f"the viewshed's resolution must be positive metres, got {resolution}")
    width = math.ceil((geometry.x_max - geometry.x_min) / resolution - 1e-9)
    height = math.ceil((geometry.y_max - geometry.y_min) / resolution - 1e-9)
    return GridGeometry(geometry.x_min, geometry.y_max, resolution, width, height, geometry.crs)
