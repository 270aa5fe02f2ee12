"""The adjustment of a resection: robust fit, then least squares over the points that it does not call outliers.

Source: Luhmann et al., Close-Range Photogrammetry, 3rd ed., 4.2.3 (space resection), 2.4 (adjustment, precision).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import least_squares

from ltm_core.camera import Camera
from ltm_core.errors import PoseError
from ltm_core.pose import Pose
from ltm_core.pose_estimation.control_points import ControlPoints
from ltm_core.rotations import matrix_of_vector
from ltm_core.types import BoolArray, Float64Array
from ltm_core.visibility.line_of_sight import line_of_sight_vectors

Parameter = Literal["focal", "k1", "position"]
"""What may be fitted besides the angles, which always are."""

PARAMETERS: tuple[Parameter, ...] = ("focal", "k1", "position")
SIZE = {"focal": 1, "k1": 1, "position": 3}
"""Numbers that each parameter is."""

MIN_REDUNDANCY = 2
"""Measured coordinates beyond the number of parameters: with fewer no error shows."""
OUTLIER_SIGMAS = 4.0
MAX_OUTLIER_SHARE = 0.25

REMEDY = (
    "Check their pixels (counted from 0 or 1, of this image?), their coordinates (order, CRS, height datum), the "
    "camera's position and its focal length"
)


@dataclass(frozen=True, eq=False)
class Fit:
    camera: Camera
    pose: Pose
    residuals: Float64Array
    used: BoolArray
    sigma_px: float
    covariance: Float64Array
    """Of rotation (rad), then the free parameters."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    points: ControlPoints
    bend: float
    position: Float64Array
    position_sigma: Float64Array | None

    def robust_fit(
        self, pose: Pose, camera: Camera, free: tuple[Parameter, ...], sigma_px: float, rounds: int = 4
    ) -> Fit:
        """Soft-L1, then Cauchy loss, which gross errors move less; the median residual of all points is its scale."""
        everyone = np.ones(len(self.points.names), bool)
        fit = Fit(camera, pose, self._residuals(camera, pose), everyone, 0.0, np.empty(0))
        for turn in range(rounds):
            scale = max(sigma_px, _scale(fit.residuals, 3 + size_of(free)))
            fit = self._solve(
                fit, free, everyone, min(scale, diagonal(camera) / 20), "soft_l1" if turn == 0 else "cauchy"
            )
        return fit

    def without_outliers(self, fit: Fit, free: tuple[Parameter, ...], sigma_px: float) -> Fit:
        """Least squares over the points within OUTLIER_SIGMAS, until that set stays."""
        size = 3 + size_of(free)
        before = None
        for _ in range(10):
            used = lengths(fit.residuals) <= OUTLIER_SIGMAS * max(sigma_px, _scale(fit.residuals, size))
            if 2 * used.sum() < size + MIN_REDUNDANCY or used.mean() < 1 - MAX_OUTLIER_SHARE:
                raise PoseError(
                    f"{(~used).sum()} of {len(used)} control points fit no common pose: "
                    f"{named(self.points, fit.residuals, ~used)}. {REMEDY}"
                )
            settled = before is not None and bool((used == before).all())
            spread = float(np.sqrt(np.sum(fit.residuals[used] ** 2) / (2 * used.sum() - size)))
            fit = self._solve(fit, free, used, max(sigma_px, spread), "linear")
            if settled:
                break
            before = used
        return fit

    def _residuals(self, camera: Camera, pose: Pose) -> Float64Array:
        sight = line_of_sight_vectors(pose.position, self.points.places, self.bend)
        return np.asarray(self.points.pixels - camera.project(sight @ pose.rotation), np.float64)

    def _solve(self, start: Fit, free: tuple[Parameter, ...], used: BoolArray, sigma_px: float, loss: str) -> Fit:
        far = 2 * diagonal(start.camera)

        def errors(x: Float64Array) -> Float64Array:
            camera, pose = _applied(x, start.camera, start.pose, free)
            # A point behind the camera has no pixel; a constant keeps it from pulling.
            rows = np.nan_to_num(self._residuals(camera, pose)[used], nan=far).ravel() / sigma_px
            if "position" in free and self.position_sigma is not None:
                rows = np.concatenate([rows, (pose.position - self.position) / self.position_sigma])
            return rows

        x0 = np.zeros(3 + size_of(free))
        solved = least_squares(errors, x0, jac="3-point", x_scale="jac", loss=loss, max_nfev=100)
        camera, pose = _applied(solved.x, start.camera, start.pose, free)
        return Fit(camera, pose, self._residuals(camera, pose), used, sigma_px, _inverse(solved.jac))


def _applied(x: Float64Array, camera: Camera, pose: Pose, free: tuple[Parameter, ...]) -> tuple[Camera, Pose]:
    """Camera and pose moved by x: rotation vector in the map frame, log of the focal length, k1, position."""
    rest = list(x[3:])
    position = pose.position
    for name in free:
        if name == "focal":
            factor = float(np.exp(np.clip(rest.pop(0), -5, 5)))
            camera = camera.zoomed(factor)
        elif name == "k1":
            camera = replace(camera, distortion=(camera.distortion[0] + float(rest.pop(0)), *camera.distortion[1:]))
        else:
            position = position + np.array([rest.pop(0) for _ in range(3)])
    return camera, Pose(position, matrix_of_vector(x[:3]) @ pose.rotation)


def _inverse(jacobian: Float64Array) -> Float64Array:
    """(J^T J)^-1; a direction that J does not see gets a variance that is huge, not infinite."""
    norms = np.linalg.norm(jacobian, axis=0)
    norms[norms == 0] = 1e-12
    _, singular, basis = np.linalg.svd(jacobian / norms, full_matrices=False)
    singular = np.maximum(singular, 1e-10 * singular.max())
    half = basis.T / singular
    return np.asarray((half @ half.T) / np.outer(norms, norms), np.float64)


def named(points: ControlPoints, residuals: Float64Array, which: BoolArray) -> str:
    """The points of `which` by residual, largest first."""
    off = lengths(residuals)
    order = [i for i in np.argsort(-off, kind="stable") if which[i]]
    shown = [
        f"{points.names[i]} ({'behind the camera' if np.isinf(off[i]) else f'off by {off[i]:.0f} px'})"
        for i in order[:8]
    ]
    return ", ".join(shown) + (f" and {len(order) - 8} more" if len(order) > 8 else "")


def lengths(residuals: Float64Array) -> Float64Array:
    return np.nan_to_num(np.hypot(residuals[:, 0], residuals[:, 1]), nan=np.inf)


def median_px(residuals: Float64Array) -> float:
    return float(np.median(lengths(residuals)))


def _scale(residuals: Float64Array, parameters: int) -> float:
    """Deviation of one coordinate from the median length (of a Rayleigh variate: 1.1774 sigma), for n - p."""
    observed = residuals.size
    return median_px(residuals) / 1.1774 * float(np.sqrt(observed / (observed - parameters)))


def size_of(free: tuple[Parameter, ...]) -> int:
    return sum(SIZE[name] for name in free)


def diagonal(camera: Camera) -> float:
    return float(np.hypot(camera.width, camera.height))
