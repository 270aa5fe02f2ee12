"""Result of tracing an image: slant range for every pixel, and the depths, points and DEM cells derived from it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, Int32Array
from ltm_core.geometry.camera import Camera, strips
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose


def _require_shape(what: str, image: Float32Array, camera: Camera) -> None:
    rows, columns = camera.height, camera.width
    if image.shape != (rows, columns):
        size = f"{rows} x {columns} (rows x columns)"
        raise ImageError(f"{what} image of shape {image.shape} does not fit a camera of {size}")


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Ranges of one image, and where its pixels lie on the map.

    `range`: (H, W) float32 slant metres along each pixel's ray; +inf sky, NaN unknown (outside the DEM, nodata, or
    a pixel without a ray), after REP-117. `bend`: the ray's curvature coefficient (see `geodesy.ray_bend`): over
    horizontal range r a ray of slope s stands at z0 + s r + bend r^2, and its slant range is r sqrt(1 + s^2).
    `geometry`: the raster whose cells `cells()` counts."""

    range: Float32Array
    camera: Camera
    pose: Pose
    bend: float = 0.0
    geometry: GridGeometry | None = None

    def __post_init__(self) -> None:
        _require_shape("range", self.range, self.camera)

    @classmethod
    def from_depth(cls, depth: Float32Array, camera: Camera, pose: Pose, bend: float = 0.0) -> "RangeImage":
        """Return the range image of depths along the optical axis (REP-118), (H, W) metres; the inverse of
        `depth()`."""
        _require_shape("depth", depth, camera)
        slant = (depth / camera.cosines()).astype(np.float32, copy=False)
        return cls(slant, camera, pose, bend)

    def depth(self) -> Float32Array:
        """Return the distance along the optical axis, (H, W) metres (REP-118)."""
        depth: Float32Array = self.range * self.camera.cosines()
        return depth

    def horizontal(self) -> Float32Array:
        """Return the horizontal distance from the camera, (H, W) metres, read-only: the paper's depth (Algorithm 1,
        line 9)."""
        return self._horizontal

    @cached_property
    def _horizontal(self) -> Float32Array:
        up = self.camera.rays() @ self.pose.rotation[2]
        with np.errstate(invalid="ignore"):
            horizontal = (self.range * np.sqrt(np.maximum(0.0, 1.0 - up * up))).astype(np.float32)
        found = np.where(np.isinf(self.range), np.float32(np.inf), horizontal)
        found.flags.writeable = False
        return found

    def points(self) -> Float32Array:
        """Return the map coordinates of what each pixel sees, (H, W, 3) metres, read-only; NaN where the range is not
        finite."""
        return self._points

    @cached_property
    def _points(self) -> Float32Array:
        found = np.empty((*self.range.shape, 3), np.float32)
        for rows in strips(len(found)):
            slant = np.where(np.isfinite(self.range[rows]), self.range[rows], np.nan).astype(np.float64)
            points = (self.camera.rays()[rows] @ self.pose.rotation.T) * slant[..., None]
            if self.bend:
                points[..., 2] += self.bend * (points[..., 0] ** 2 + points[..., 1] ** 2)
            found[rows] = points + self.pose.position
        found.flags.writeable = False
        return found

    def cells(self) -> Int32Array:
        """Return the DEM cell (row, col) that each pixel sees, (H, W, 2); -1 where it sees none. The paper's
        img-DEM."""
        if self.geometry is None:
            raise ImageError("this range image has no raster, so it has no cells")
        cells = np.empty((*self.range.shape, 2), np.int32)
        for rows in strips(len(cells)):
            x, y, _ = np.moveaxis(self.points()[rows], -1, 0)
            seen = np.isfinite(x)
            row, col = self.geometry.cell_of(np.where(seen, x, 0), np.where(seen, y, 0))
            seen &= self.geometry.contains(row, col)
            cells[rows] = np.where(seen, (row, col), -1).transpose(1, 2, 0)
        return cells


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Depths of one image as sent between nodes: the part of a `RangeImage` that fusion needs.

    `along`: (H, W) float32 metres along the optical axis (REP-118); +inf sky, NaN unknown."""

    along: Float32Array
    camera: Camera
    pose: Pose

    def __post_init__(self) -> None:
        _require_shape("depth", self.along, self.camera)

    def depth(self) -> Float32Array:
        """Return the depth as `RangeImage.depth`, row by row, without a copy if already in this order."""
        return np.ascontiguousarray(self.along)
