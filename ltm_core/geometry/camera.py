"""Project rays to pixels and pixels to rays: a pinhole camera with Brown-Conrady distortion."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ltm_core.base.errors import CameraError
from ltm_core.base.types import Float32Array, Float64Array

MOST_A_SIDE = 65_535
"""Maximum number of pixels per side, the limit of JPEG."""


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera.

    Pixels (u, v) = (column, row) with integers at pixel centres, as OpenCV and ROS count them. `distortion` is
    (k1, k2, p1, p2, k3), the plumb_bob order of sensor_msgs/CameraInfo. Optical frame: x right, y down, z forward.
    Raises CameraError on values that make no camera."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if len(self.distortion) != 5:
            raise CameraError(f"distortion needs (k1, k2, p1, p2, k3), got {self.distortion}")
        if not all(math.isfinite(v) for v in values):
            raise CameraError(f"camera intrinsics must be finite, got {values}")
        if max(map(abs, self.distortion)) > 1e15:  # beyond it the model's own terms overflow
            raise CameraError(
                f"distortion {self.distortion} is not that of a lens; give (k1, k2, p1, p2, k3) of plumb_bob"
            )
        if not (1 <= self.width <= MOST_A_SIDE and 1 <= self.height <= MOST_A_SIDE):
            raise CameraError(f"camera images have 1 to {MOST_A_SIDE} pixels a side, got {self.width} x {self.height}")
        if self.fx <= 0 or self.fy <= 0:
            raise CameraError(f"focal lengths must be positive pixels, got fx={self.fx}, fy={self.fy}")

    @classmethod
    def from_fov(cls, width: int, height: int, hfov_deg: float) -> "Camera":
        """Return an undistorted camera with square pixels whose image edges span `hfov_deg` horizontally."""
        if not 0 < hfov_deg < 180:
            raise CameraError(f"horizontal field of view must lie in (0, 180) degrees, got {hfov_deg}")
        f = width / 2 / math.tan(math.radians(hfov_deg) / 2)
        return cls(width, height, f, f, (width - 1) / 2, (height - 1) / 2)

    @property
    def matrix(self) -> Float64Array:
        """K, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def hfov_deg(self) -> float:
        """Return the horizontal field of view between the image's outer edges, distortion left aside."""
        left = math.atan((self.cx + 0.5) / self.fx)
        right = math.atan((self.width - 0.5 - self.cx) / self.fx)
        return math.degrees(left + right)

    def scaled(self, step: int) -> "Camera":
        """The camera of the image `image[::step, ::step]`: every step-th pixel, sampled at its centre."""
        if step < 1:
            raise CameraError(f"sampling step must be at least 1, got {step}")
        width, height = (self.width + step - 1) // step, (self.height + step - 1) // step
        fx, fy, cx, cy = (v / step for v in (self.fx, self.fy, self.cx, self.cy))
        return Camera(width, height, fx, fy, cx, cy, self.distortion)

    def resized(self, width: int, height: int) -> "Camera":
        """Return the camera of an image of another size, in pixels, that shows the same, edge to edge."""
        across, down = width / self.width, height / self.height
        centre = (self.cx + 0.5) * across - 0.5, (self.cy + 0.5) * down - 0.5
        return Camera(width, height, self.fx * across, self.fy * down, *centre, self.distortion)

    def zoomed(self, factor: float) -> "Camera":
        """Return the camera with `factor` times the focal length."""
        return replace(self, fx=self.fx * factor, fy=self.fy * factor)

    def rays(self) -> Float64Array:
        """Return the unit viewing rays of all pixels in the optical frame, (H, W, 3), read-only.

        NaN where the distortion cannot be inverted: such a pixel lies beyond the model's fold, and no ray projects
        to it."""
        return _rays(self)

    def cosines(self) -> Float32Array:
        """Return the third component of `rays()`, (H, W) float32, read-only: the depth along the optical axis (REP-118)
        of a point one metre away."""
        return _cosines(self)

    def project(self, points: Float64Array) -> Float64Array:
        """Return the pixels (..., 2) of optical-frame points (..., 3); NaN behind the camera or beyond the distortion's
        fold."""
        points = np.asarray(points, np.float64)
        z = points[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            x = np.where(z > 0, points[..., 0] / z, np.nan)
            y = np.where(z > 0, points[..., 1] / z, np.nan)
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        beyond = r2 > _fold_radius_squared(self.distortion)
        uv = np.stack([self.fx * xd + self.cx, self.fy * yd + self.cy], axis=-1)
        uv[beyond] = np.nan
        return np.asarray(uv, np.float64)


def strips(height: int) -> Iterator[slice]:
    """Yield the rows of an image 16 at a time, so that intermediate results stay in the processor's cache."""
    return (slice(first, first + 16) for first in range(0, height, 16))


@lru_cache(maxsize=64)
def _fold_radius_squared(distortion: tuple[float, float, float, float, float]) -> float:
    """Squared undistorted radius where the radial model stops growing: beyond it two rays share a pixel."""
    k1, k2, _, _, k3 = distortion
    # d/dr (r (1 + k1 r^2 + k2 r^4 + k3 r^6)) = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 with s = r^2; solved for 1 / s, since
    # the polynomial's first coefficient is then 1 and not the smallest of them.
    roots = np.roots([1.0, 3 * k1, 5 * k2, 7 * k3])
    positive = [1 / float(r.real) for r in roots if abs(r.imag) < 1e-12 and r.real > 0]
    return min(positive, default=math.inf)


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> Float64Array:
    rays = np.empty((camera.height, camera.width, 3))
    if any(camera.distortion):
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        fold = _fold_radius_squared(camera.distortion)
        # Here, for most processes of a graph know cameras and no kernel, and numba takes a third of a second to load.
        from ltm_core.base.kernels import in_parallel
        from ltm_core.geometry.lens_inversion import undistorted_rays

        distortion = np.array(camera.distortion)
        in_parallel(lambda first, end: undistorted_rays(first, end, rays, intrinsics, distortion, fold), camera.height)
    else:
        rays[..., 0] = (np.arange(camera.width) - camera.cx) / camera.fx
        rays[..., 1] = ((np.arange(camera.height) - camera.cy) / camera.fy)[:, None]
        rays[..., 2] = 1.0
        rays /= np.sqrt(np.einsum("hwc,hwc->hw", rays, rays))[..., None]
    rays.flags.writeable = False
    return rays


@lru_cache(maxsize=16)  # of a site's cameras, each of which needs its own for every frame: 8 MB at 1080p
def _cosines(camera: Camera) -> Float32Array:
    cosines = np.ascontiguousarray(_rays(camera)[..., 2], np.float32)
    cosines.flags.writeable = False
    return cosines
