"""Resection: a camera's angles, focal length, k1 and position from ground control points.

The adjustment minimises the distances in the image between the points' marked pixels and their projections. It goes in
four steps: a coarse search over pairs of points (each pair and focal length gives a rotation) that outlives gross
errors; a fit with robust loss; least squares over the points that this fit does not call outliers; and a test of
which parameters the points can bear. Source: Luhmann et al., Close-Range Photogrammetry, 3rd ed., 4.2.3 (space
resection), 2.4 (adjustment, precision).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ltm_core.camera import Camera
from ltm_core.control_points import ControlPoints
from ltm_core.errors import PoseError
from ltm_core.pose import Pose
from ltm_core.resection_search import coarse_poses
from ltm_core.sight_lines import sight_vectors

Floats = NDArray[np.float64]
Parameter = Literal["focal", "k1", "position"]
"""What may be fitted besides the angles, which always are."""

PARAMETERS: tuple[Parameter, ...] = ("focal", "k1", "position")
_SIZE = {"focal": 1, "k1": 1, "position": 3}

MIN_REDUNDANCY = 2
"""Measured coordinates beyond the number of parameters: with fewer no error shows."""
OUTLIER_SIGMAS = 4.0
MAX_OUTLIER_SHARE = 0.25
MAX_MEDIAN_SHARE = 0.02
"""Median residual over the image's diagonal above which no pose explains the points."""

MAX_ANGLE_SIGMA_DEG = 1.0
MAX_FOCAL_SIGMA = 0.03
"""Of the focal length."""
MAX_K1_SHIFT = 0.01
"""Of the image's diagonal: what one sigma of k1 moves at the image's corner."""
MAX_POSITION_SIGMA = 0.02
"""Of the median distance of the points."""


@dataclass(frozen=True, eq=False)
class Resection:
    """A fitted camera.

    `residuals`: (N, 2) pixels, marked minus projected; NaN for a point behind the camera. `used`: (N,) the points that
    were not outliers. `sigma_px`: standard deviation of one measured coordinate, from the residuals but not below the
    stated one. `held`: parameters that were asked for but not fitted, with the reason. `sigmas`: standard deviations by
    name: azimuth_deg, pitch_deg, roll_deg, and where they were fitted fx (pixels), k1, x, y, z (metres).
    `pose_covariance`: (6, 6) over x, y, z (m) and rotations about the map's x, y, z (rad), as in
    geometry_msgs/PoseWithCovariance; a held position has the variance that it was given, or zero. `covariance`: of
    the fitted parameters in the order rotation x, y, z (rad), then `fitted`: focal (as a share), k1, position (m).
    """

    points: ControlPoints
    camera: Camera
    pose: Pose
    fitted: tuple[Parameter, ...]
    held: dict[Parameter, str]
    residuals: Floats
    used: NDArray[np.bool_]
    sigma_px: float
    sigmas: dict[str, float]
    covariance: Floats
    pose_covariance: Floats

    @property
    def residual_px(self) -> Floats:
        """(N,) lengths of the residuals, pixels; +inf behind the camera."""
        return np.nan_to_num(np.hypot(self.residuals[:, 0], self.residuals[:, 1]), nan=np.inf)

    @property
    def outliers(self) -> tuple[str, ...]:
        return tuple(np.array(self.points.names)[~self.used])


def resect(
    points: ControlPoints,
    camera: Camera,
    position: ArrayLike,
    angles_deg: tuple[float, float, float] | None = None,
    free: Sequence[Parameter] = ("focal", "k1"),
    bend: float = 0.0,
    position_sigma: ArrayLike | None = None,
    sigma_px: float = 1.0,
) -> Resection:
    """Fit the camera to the points.

    Args:
        points: control points; pixels counted as everywhere here, (0, 0) the centre of the top-left pixel.
        camera: start of focal length and k1; its other values are kept, and fy / fx too.
        position: (3,) map metres: held, or the start where "position" is free.
        angles_deg: (azimuth, pitch, roll) where they are roughly known; they only help the search.
        free: parameters to fit besides the angles. One that the points cannot bear is held, with a reason.
        bend: curvature coefficient of the rays, `geodesy.ray_bend`.
        position_sigma: how well `position` is known, metres, one or three: an observation of weight 1 / sigma^2 where
            the position is free, and its variance where it is not.
        sigma_px: what a click is worth at best, pixels.

    Raises PoseError that names the points: fewer than three, outside the image, crowded or in line so that the angles
    do not follow from them, behind the camera, or so wrong that no pose explains them.
    """
    unknown = [name for name in free if name not in PARAMETERS]
    if unknown:
        raise PoseError(f"cannot fit {', '.join(unknown)}: free parameters are {', '.join(PARAMETERS)}")
    if not sigma_px > 0:
        raise PoseError(f"the sigma of a marked pixel must be positive, got {sigma_px}")
    origin = np.asarray(position, np.float64)
    sigma = _position_sigma(position_sigma)
    _check(points, camera, origin)
    chosen = [name for name in PARAMETERS if name in free]
    held = _hold_for_redundancy(chosen, len(points.names), sigma is not None)

    starts = coarse_poses(points, camera, origin, angles_deg, "focal" in chosen, "position" in chosen, bend)
    problem = _Problem(points, bend, origin, sigma)
    rough: tuple[Parameter, ...] = tuple(name for name in chosen if name == "focal")
    fits = [problem.robust_fit(pose, start, rough, sigma_px, rounds=2) for start, pose in starts]
    best = min(fits, key=lambda fit: _median_px(fit.residuals))

    while True:
        fit = problem.robust_fit(best.pose, best.camera, tuple(chosen), sigma_px)
        fit = problem.without_outliers(fit, tuple(chosen), sigma_px)
        _check_fit(points, fit)
        reason = _unbearable(fit, tuple(chosen), points)
        if reason is None:
            break
        held[reason[0]] = reason[1]
        chosen.remove(reason[0])
    return _result(points, fit, tuple(chosen), held, sigma)


@dataclass(frozen=True, eq=False)
class _Fit:
    camera: Camera
    pose: Pose
    residuals: Floats
    used: NDArray[np.bool_]
    sigma_px: float
    covariance: Floats
    """Of rotation (rad), then the free parameters."""


@dataclass(frozen=True, eq=False)
class _Problem:
    points: ControlPoints
    bend: float
    position: Floats
    position_sigma: Floats | None

    def robust_fit(
        self, pose: Pose, camera: Camera, free: tuple[Parameter, ...], sigma_px: float, rounds: int = 4
    ) -> _Fit:
        """Soft-L1, then Cauchy loss, which gross errors move less; the median residual of all points is its scale."""
        everyone = np.ones(len(self.points.names), bool)
        fit = _Fit(camera, pose, self._residuals(camera, pose), everyone, 0.0, np.empty(0))
        for turn in range(rounds):
            scale = max(sigma_px, _scale(fit.residuals, 3 + _count(free)))
            fit = self._solve(
                fit, free, everyone, min(scale, _diagonal(camera) / 20), "soft_l1" if turn == 0 else "cauchy"
            )
        return fit

    def without_outliers(self, fit: _Fit, free: tuple[Parameter, ...], sigma_px: float) -> _Fit:
        """Least squares over the points within OUTLIER_SIGMAS, until that set stays."""
        size = 3 + _count(free)
        before = None
        for _ in range(10):
            used = _lengths(fit.residuals) <= OUTLIER_SIGMAS * max(sigma_px, _scale(fit.residuals, size))
            if 2 * used.sum() < size + MIN_REDUNDANCY or used.mean() < 1 - MAX_OUTLIER_SHARE:
                raise PoseError(
                    f"{(~used).sum()} of {len(used)} control points fit no common pose: "
                    f"{_named(self.points, fit.residuals, ~used)}. {_REMEDY}"
                )
            settled = before is not None and bool((used == before).all())
            spread = float(np.sqrt(np.sum(fit.residuals[used] ** 2) / (2 * used.sum() - size)))
            fit = self._solve(fit, free, used, max(sigma_px, spread), "linear")
            if settled:
                break
            before = used
        return fit

    def _residuals(self, camera: Camera, pose: Pose) -> Floats:
        sight = sight_vectors(pose.position, self.points.places, self.bend)
        return np.asarray(self.points.pixels - camera.project(sight @ pose.rotation), np.float64)

    def _solve(
        self, start: _Fit, free: tuple[Parameter, ...], used: NDArray[np.bool_], sigma_px: float, loss: str
    ) -> _Fit:
        far = 2 * _diagonal(start.camera)

        def errors(x: Floats) -> Floats:
            camera, pose = _applied(x, start.camera, start.pose, free)
            # A point behind the camera has no pixel; a constant keeps it from pulling.
            rows = np.nan_to_num(self._residuals(camera, pose)[used], nan=far).ravel() / sigma_px
            if "position" in free and self.position_sigma is not None:
                rows = np.concatenate([rows, (pose.position - self.position) / self.position_sigma])
            return rows

        x0 = np.zeros(3 + _count(free))
        solved = least_squares(errors, x0, jac="3-point", x_scale="jac", loss=loss, max_nfev=100)
        camera, pose = _applied(solved.x, start.camera, start.pose, free)
        return _Fit(camera, pose, self._residuals(camera, pose), used, sigma_px, _inverse(solved.jac))


def _applied(x: Floats, camera: Camera, pose: Pose, free: tuple[Parameter, ...]) -> tuple[Camera, Pose]:
    """Camera and pose moved by x: rotation vector in the map frame, log of the focal length, k1, position."""
    rest = list(x[3:])
    position = pose.position
    for name in free:
        if name == "focal":
            factor = float(np.exp(np.clip(rest.pop(0), -5, 5)))
            camera = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
        elif name == "k1":
            camera = replace(camera, distortion=(camera.distortion[0] + float(rest.pop(0)), *camera.distortion[1:]))
        else:
            position = position + np.array([rest.pop(0) for _ in range(3)])
    return camera, Pose(position, Rotation.from_rotvec(x[:3]).as_matrix() @ pose.rotation)


def _inverse(jacobian: Floats) -> Floats:
    """(J^T J)^-1; a direction that J does not see gets a variance that is huge, not infinite."""
    norms = np.linalg.norm(jacobian, axis=0)
    norms[norms == 0] = 1e-12
    _, singular, basis = np.linalg.svd(jacobian / norms, full_matrices=False)
    singular = np.maximum(singular, 1e-10 * singular.max())
    half = basis.T / singular
    return np.asarray((half @ half.T) / np.outer(norms, norms), np.float64)


def _unbearable(fit: _Fit, free: tuple[Parameter, ...], points: ControlPoints) -> tuple[Parameter, str] | None:
    """The free parameter that the points bear least, and why; None where they bear all. Raises for the angles."""
    camera = fit.camera
    sigma = np.sqrt(np.diag(fit.covariance))
    sights = points.places[fit.used] - fit.pose.position
    distance = float(np.median(np.linalg.norm(sights, axis=1)))
    worst: tuple[float, Parameter, str] | None = None
    at = 3
    for name in free:
        own = float(sigma[at : at + _SIZE[name]].max())
        at += _SIZE[name]
        if name == "focal":
            excess, reason = own / MAX_FOCAL_SIGMA, f"its sigma would be {own:.1%} (limit {MAX_FOCAL_SIGMA:.0%})"
        elif name == "k1":
            corner = _corner_radius(camera)
            shift = own * corner**3 * camera.fx
            limit = MAX_K1_SHIFT * _diagonal(camera)
            excess = shift / limit
            reason = f"its sigma would be {own:.2g}, {shift:.0f} px at the image's corner (limit {limit:.0f} px)"
        else:
            limit = MAX_POSITION_SIGMA * distance
            excess = own / limit
            reason = f"its sigma would be {own:.3g} m (limit {limit:.3g} m, {MAX_POSITION_SIGMA:.0%} of the distance)"
            if _in_line(points.places[fit.used]):
                reason += "; the points lie in one line"
        if excess > 1 and (worst is None or excess > worst[0]):
            worst = excess, name, f"{reason}: mark points that differ more in distance and place in the image"
    if worst is not None:
        return worst[1], worst[2]
    turn = float(np.degrees(np.sqrt(np.linalg.eigvalsh(fit.covariance[:3, :3]).max())))
    if turn <= MAX_ANGLE_SIGMA_DEG:
        return None
    if free:
        name = "position" if "position" in free else free[-1]
        return name, f"with it the angles' sigma would be {turn:.2g} degrees (limit {MAX_ANGLE_SIGMA_DEG:g})"
    raise PoseError(
        f"the camera's angles do not follow from the control points {', '.join(points.names)}: sigma {turn:.2g} "
        f"degrees (limit {MAX_ANGLE_SIGMA_DEG:g}); mark points further apart in the image, and check their pixels"
    )


def _result(
    points: ControlPoints, fit: _Fit, fitted: tuple[Parameter, ...], held: dict[Parameter, str], sigma: Floats | None
) -> Resection:
    pose_covariance = np.zeros((6, 6))
    turns = np.arange(3)
    pose_covariance[3:, 3:] = fit.covariance[:3, :3]
    sigmas = _angle_sigmas(fit.pose, fit.covariance[:3, :3])
    deviations = np.sqrt(np.diag(fit.covariance))
    at = 3
    for name in fitted:
        if name == "focal":
            sigmas["fx"] = float(deviations[at]) * fit.camera.fx
        elif name == "k1":
            sigmas["k1"] = float(deviations[at])
        else:
            place = at + np.arange(3)
            sigmas.update(zip("xyz", map(float, deviations[place]), strict=True))
            pose_covariance[:3, :3] = fit.covariance[np.ix_(place, place)]
            pose_covariance[:3, 3:] = fit.covariance[np.ix_(place, turns)]
            pose_covariance[3:, :3] = pose_covariance[:3, 3:].T
        at += _SIZE[name]
    if "position" not in fitted and sigma is not None:
        pose_covariance[:3, :3] = np.diag(sigma**2)
    return Resection(
        points,
        fit.camera,
        fit.pose,
        fitted,
        held,
        fit.residuals,
        fit.used,
        fit.sigma_px,
        sigmas,
        fit.covariance,
        pose_covariance,
    )


def _angle_sigmas(pose: Pose, turns: Floats) -> dict[str, float]:
    """Deviations in degrees of azimuth, pitch and roll, from the covariance of the rotation about the map's axes."""
    step = 1e-6
    slopes = np.empty((3, 3))
    for axis in range(3):
        moved = Rotation.from_rotvec(step * np.eye(3)[axis]).as_matrix() @ pose.rotation
        change = np.array(Pose(pose.position, moved).angles_deg) - np.array(pose.angles_deg)
        slopes[:, axis] = ((change + 180) % 360 - 180) / step
    deviations = np.sqrt(np.diag(slopes @ turns @ slopes.T))
    return dict(zip(("azimuth_deg", "pitch_deg", "roll_deg"), map(float, deviations), strict=True))


def _hold_for_redundancy(chosen: list[Parameter], count: int, prior: bool) -> dict[Parameter, str]:
    """Take parameters out of `chosen` that so few points cannot fit, k1 first."""
    held: dict[Parameter, str] = {}
    for name in ("k1", "position", "focal"):
        observed = 2 * count + (3 if prior and "position" in chosen else 0)
        needed = 3 + _count(tuple(chosen)) + MIN_REDUNDANCY
        if observed >= needed:
            break
        if name in chosen:
            chosen.remove(name)
            held[name] = f"{count} points are too few to fit it: {(needed + 1) // 2} are needed"
    return held


def _check(points: ControlPoints, camera: Camera, position: Floats) -> None:
    names = np.array(points.names)
    if len(names) < 3:
        raise PoseError(f"resection needs at least 3 control points, got {len(names)}: {', '.join(names) or 'none'}")
    if position.shape != (3,) or not np.isfinite(position).all():
        raise PoseError(f"the camera's position must be three finite metres, got {position.tolist()}")
    u, v = points.pixels.T
    outside = (u < -0.5) | (v < -0.5) | (u > camera.width - 0.5) | (v > camera.height - 0.5)
    if outside.any():
        at = ", ".join(f"{n} ({a:g}, {b:g})" for n, a, b in zip(names[outside], u[outside], v[outside], strict=True))
        raise PoseError(
            f"control points outside the image of {camera.width} x {camera.height} pixels: {at}; is the calibration "
            "that of this image size, are u (column) and v (row) in their order, are pixels counted from 0 or 1?"
        )
    near = np.linalg.norm(points.places - position, axis=1) < 1.0
    if near.any():
        raise PoseError(f"control points within 1 m of the camera: {', '.join(names[near])}; check the position")


def _check_fit(points: ControlPoints, fit: _Fit) -> None:
    limit = MAX_MEDIAN_SHARE * _diagonal(fit.camera)
    median = _median_px(fit.residuals)
    if median > limit:
        raise PoseError(
            f"no pose explains the control points: the median residual is {median:.0f} px (limit {limit:.0f} px): "
            f"{_named(points, fit.residuals, np.ones(len(points.names), bool))}. {_REMEDY}"
        )


_REMEDY = (
    "Check their pixels (counted from 0 or 1, of this image?), their coordinates (order, CRS, height datum), the "
    "camera's position and its focal length"
)


def _named(points: ControlPoints, residuals: Floats, which: NDArray[np.bool_]) -> str:
    """The points of `which` by residual, largest first."""
    lengths = _lengths(residuals)
    order = [i for i in np.argsort(-lengths, kind="stable") if which[i]]
    shown = [
        f"{points.names[i]} ({'behind the camera' if np.isinf(lengths[i]) else f'off by {lengths[i]:.0f} px'})"
        for i in order[:8]
    ]
    return ", ".join(shown) + (f" and {len(order) - 8} more" if len(order) > 8 else "")


def _in_line(places: Floats) -> bool:
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(spread[1] < 0.02 * spread[0])


def _lengths(residuals: Floats) -> Floats:
    return np.nan_to_num(np.hypot(residuals[:, 0], residuals[:, 1]), nan=np.inf)


def _median_px(residuals: Floats) -> float:
    return float(np.median(_lengths(residuals)))


def _scale(residuals: Floats, parameters: int) -> float:
    """Deviation of one coordinate from the median length (of a Rayleigh variate: 1.1774 sigma), for n - p."""
    observed = residuals.size
    return _median_px(residuals) / 1.1774 * float(np.sqrt(observed / (observed - parameters)))


def _count(free: tuple[Parameter, ...]) -> int:
    return sum(_SIZE[name] for name in free)


def _diagonal(camera: Camera) -> float:
    return float(np.hypot(camera.width, camera.height))


def _corner_radius(camera: Camera) -> float:
    """Of the corner farthest from the principal point, in focal lengths."""
    x = max(camera.cx, camera.width - 1 - camera.cx) / camera.fx
    y = max(camera.cy, camera.height - 1 - camera.cy) / camera.fy
    return float(np.hypot(x, y))


def _position_sigma(sigma: ArrayLike | None) -> Floats | None:
    if sigma is None:
        return None
    values = np.broadcast_to(np.asarray(sigma, np.float64), (3,))
    if not (np.isfinite(values).all() and (values > 0).all()):
        raise PoseError(f"the position's sigma must be positive metres, got {np.asarray(sigma).tolist()}")
    return values
