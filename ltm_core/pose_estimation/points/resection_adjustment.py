"""Adjust the parameters of a resection; decide which of them the control points determine. Source: see `resection`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import scipy  # loads its parts when they are first used

from ltm_core.base.errors import PoseError
from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, matrix_of_vector
from ltm_core.pose_estimation.lens import RADIAL, LensPrior, RadialTrend, corner_radius
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.visibility.footprint import line_of_sight_vectors

Parameter = Literal["focal", "k1", "k2", "k3", "centre", "position"]  # besides the angles, always fitted

Free = tuple[Parameter, ...]
PARAMETERS: Free = get_args(Parameter)
LENS: Free = PARAMETERS[:-1]
SIZE = {"focal": 1, "k1": 1, "k2": 1, "k3": 1, "centre": 2, "position": 3}  # number of values of each parameter

MIN_REDUNDANCY = 2  # minimum excess of coordinates over parameters; with fewer, no error is detected
OUTLIER_SIGMAS = 4.0
MAX_OUTLIER_SHARE = 0.25
MAX_MEDIAN_SHARE = 0.02  # median residual, as a share of the image's diagonal, above which no pose explains the points
MAX_ANGLE_SIGMA_DEG = 1.0
MAX_FOCAL_SIGMA = 0.03  # maximum standard deviation of the focal length, as a share of it
MAX_LENS_SHIFT = 0.01  # maximum shift at the corner by one sigma of a lens parameter, share of the diagonal
MAX_POSITION_SIGMA = 0.02  # maximum standard deviation of the position, as a share of the median distance of the points

REMEDY = (
    "Check their pixels (counted from 0 or 1, of this image?), their coordinates (order, CRS, height datum), the "
    "camera's position and its focal length"
)


class NoCommonPoseError(PoseError):
    """The points do not fit one pose of a camera with these free parameters."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted camera. `residuals`: (N, 2) pixels, marked minus projected; NaN for a point behind the camera. `used`:
    (N,) the points that are not outliers. `sigma_px`: standard deviation of one measured coordinate, from the residuals
    but not below the stated one. `covariance`: of the rotation about the map's axes (rad), then of the free parameters:
    focal (as a share), k1, k2, k3, centre (pixels), position (m)."""

    camera: Camera
    pose: Pose
    residuals: Float64Array
    used: BoolArray
    sigma_px: float
    covariance: Float64Array

    @property
    def residual_px(self) -> Float64Array:
        """Return (N,) lengths of the residuals, pixels; +inf behind the camera."""
        return np.nan_to_num(np.hypot(self.residuals[:, 0], self.residuals[:, 1]), nan=np.inf)

    @property
    def median_px(self) -> float:
        return float(np.median(self.residual_px))

    def scale(self, parameters: int) -> float:
        """Return the deviation of one coordinate by the median length (Rayleigh: 1.1774 sigma), for n - p."""
        observed = self.residuals.size
        return self.median_px / 1.1774 * float(np.sqrt(observed / (observed - parameters)))


@dataclass(frozen=True, eq=False)
class Adjustment:
    points: ControlPoints
    bend: float
    position: Float64Array
    position_sigma: Float64Array | None
    lens: LensPrior | None = None
    """Prior of the lens parameters that are free; without one, the points alone determine them."""

    @property
    def known(self) -> Free:
        """Return the parameters that are observed besides the points, if they are free."""
        return (LENS if self.lens else ()) + (("position",) if self.position_sigma is not None else ())

    def robust_fit(self, pose: Pose, camera: Camera, free: Free, sigma_px: float, rounds: int = 4) -> Fit:
        """Fit with soft-L1, then Cauchy loss, against gross errors; the median residual is the scale."""
        everyone = np.ones(len(self.points.names), bool)
        fit = Fit(camera, pose, self._residuals(camera, pose), everyone, 0.0, np.empty(0))
        for turn in range(rounds):
            scale = min(max(sigma_px, fit.scale(self._unknowns(free))), diagonal(camera) / 20)
            fit = self._solve(fit, free, everyone, scale, "cauchy" if turn else "soft_l1")
        return fit

    def without_outliers(self, fit: Fit, free: Free, sigma_px: float) -> Fit:
        """Fit by least squares over the points within OUTLIER_SIGMAS until their set is stable. For the standard
        deviation, an outlier counts as if it were at that limit (Huber, Robust Statistics, 5.3: left out entirely,
        outliers make the rest look better than further points will be)."""
        size = self._unknowns(free)
        before = None
        for _ in range(10):
            limit, off = OUTLIER_SIGMAS * max(sigma_px, fit.scale(size)), fit.residual_px
            used = off <= limit
            if 2 * used.sum() < size + MIN_REDUNDANCY or used.mean() < 1 - MAX_OUTLIER_SHARE:
                raise NoCommonPoseError(
                    f"{(~used).sum()} of {len(used)} control points do not fit a common pose: "
                    f"{named(self.points.names, off, ~used)}. {REMEDY}"
                )
            settled = before is not None and bool((used == before).all())
            spread = float(np.sqrt(np.sum(np.minimum(off, limit) ** 2) / (2 * len(off) - size)))
            fit = self._solve(fit, free, used, max(sigma_px, spread), "linear")
            if settled:
                break
            before = used
        return fit

    def _unknowns(self, free: Free) -> int:
        """Return the number of parameters that the pixels alone determine; those with a prior are observed too."""
        return 3 + size_of(tuple(name for name in free if name not in self.known))

    def bending(self, fit: Fit, free: Free) -> tuple[Parameter, RadialTrend] | None:
        """Return the first radial term that is not free, and its value by the residuals; None if all are free."""
        term = next((name for name in LENS if name in RADIAL and name not in free), None)
        if term is None:
            return None
        bent = self._solve(fit, (*free, term), fit.used, fit.sigma_px, "linear")
        k = bent.camera.distortion[RADIAL[term]] - fit.camera.distortion[RADIAL[term]]
        return term, RadialTrend(k, float(np.sqrt(bent.covariance[-1, -1])))

    def _residuals(self, camera: Camera, pose: Pose) -> Float64Array:
        sight = line_of_sight_vectors(pose.position, self.points.places, self.bend)
        return np.asarray(self.points.pixels - camera.project(sight @ pose.rotation), np.float64)

    def _solve(self, start: Fit, free: Free, used: BoolArray, sigma_px: float, loss: str) -> Fit:
        far = 2 * diagonal(start.camera)

        def errors(x: Float64Array) -> Float64Array:
            camera, pose = applied(x, start.camera, start.pose, free)
            # A point behind the camera has no pixel; a constant keeps it from pulling.
            rows = np.nan_to_num(self._residuals(camera, pose)[used], nan=far).ravel() / sigma_px
            if "position" in free and self.position_sigma is not None:
                rows = np.concatenate([rows, (pose.position - self.position) / self.position_sigma])
            if self.lens is not None:
                away = self.lens.deviations(camera)
                rows = np.concatenate([rows, *(away[name] for name in free if name in away)])
            return rows

        x0 = np.zeros(3 + size_of(free))
        solved = scipy.optimize.least_squares(errors, x0, jac="3-point", x_scale="jac", loss=loss, max_nfev=100)
        camera, pose = applied(solved.x, start.camera, start.pose, free)
        return Fit(camera, pose, self._residuals(camera, pose), used, sigma_px, _inverse(solved.jac))


def applied(x: Float64Array, camera: Camera, pose: Pose, free: Free) -> tuple[Camera, Pose]:
    """Return camera and pose moved by x: rotation about the map's axes, then `free`, the focal length by its log."""
    rest = list(x[3:])
    position = pose.position
    for name in free:
        if name == "focal":
            factor = float(np.exp(np.clip(rest.pop(0), -5, 5)))
            camera = camera.zoomed(factor)
        elif name in RADIAL:
            terms = list(camera.distortion)
            terms[RADIAL[name]] += float(rest.pop(0))
            k1, k2, p1, p2, k3 = terms
            camera = replace(camera, distortion=(k1, k2, p1, p2, k3))
        elif name == "centre":
            camera = replace(camera, cx=camera.cx + float(rest.pop(0)), cy=camera.cy + float(rest.pop(0)))
        else:
            position = position + np.array([rest.pop(0) for _ in range(3)])
    return camera, Pose(position, matrix_of_vector(x[:3]) @ pose.rotation)


def _inverse(jacobian: Float64Array) -> Float64Array:
    """Return (J^T J)^-1; a direction that J does not see gets a variance that is huge, not infinite."""
    norms = np.linalg.norm(jacobian, axis=0)
    norms[norms == 0] = 1e-12
    _, singular, basis = np.linalg.svd(jacobian / norms, full_matrices=False)
    singular = np.maximum(singular, 1e-10 * singular.max())
    half = basis.T / singular
    return np.asarray((half @ half.T) / np.outer(norms, norms), np.float64)


def named(names: Sequence[str], off: Float64Array, which: BoolArray) -> str:
    """Return the points of `which` with the lengths of their residuals (N,), largest first."""
    order = [i for i in np.argsort(-off, kind="stable") if which[i]]
    known = {i: f"off by {off[i]:.0f} px" if np.isfinite(off[i]) else "behind the camera" for i in order}
    more = f" and {len(order) - 8} more" if len(order) > 8 else ""
    return ", ".join(f"{names[i]} ({known[i]})" for i in order[:8]) + more


def size_of(free: Free) -> int:
    return sum(SIZE[name] for name in free)


def diagonal(camera: Camera) -> float:
    return float(np.hypot(camera.width, camera.height))


def check_points(points: ControlPoints, camera: Camera, position: Float64Array) -> None:
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


def hold_for_redundancy(chosen: list[Parameter], count: int, known: Sequence[Parameter]) -> dict[Parameter, str]:
    """Take parameters out of `chosen` that so few points cannot fit, unless they are `known`."""
    held: dict[Parameter, str] = {}
    order: Free = ("k3", "k2", "centre", "k1", "position", "focal")
    for name in order:
        needed = 3 + size_of(tuple(other for other in chosen if other not in known)) + MIN_REDUNDANCY
        if 2 * count >= needed:
            break
        if name in chosen and name not in known:
            chosen.remove(name)
            held[name] = f"{count} points are too few to fit it: {(needed + 1) // 2} are needed"
    return held


def check_fit(points: ControlPoints, fit: Fit) -> None:
    limit = MAX_MEDIAN_SHARE * diagonal(fit.camera)
    if fit.median_px > limit:
        raise NoCommonPoseError(
            f"no pose explains the control points: the median residual is {fit.median_px:.0f} px (limit {limit:.0f} "
            f"px): {named(points.names, fit.residual_px, np.ones(len(points.names), bool))}. {REMEDY}"
        )


def unbearable(
    fit: Fit, free: Free, points: ControlPoints, known: Sequence[Parameter] = ()
) -> tuple[Parameter, str] | None:
    """Return the free parameter that the points determine worst, and why; None if they determine all except those in
    `known`. Raises for the angles."""
    sigma = np.sqrt(np.diag(fit.covariance))
    places = points.places[fit.used]
    distance = float(np.median(np.linalg.norm(places - fit.pose.position, axis=1)))
    worst: tuple[float, Parameter, str] | None = None
    at = 3
    for name in free:
        own = float(sigma[at : at + SIZE[name]].max())
        at += SIZE[name]
        instead = ""
        if name == "focal":
            excess, reason = own / MAX_FOCAL_SIGMA, f"{own:.1%} (limit {MAX_FOCAL_SIGMA:.0%})"
        elif name == "position":
            limit = MAX_POSITION_SIGMA * distance
            excess, instead = own / limit, ", or state position_sigma in the guess"
            reason = f"{own:.3g} m (limit {limit:.3g} m, {MAX_POSITION_SIGMA:.0%} of the distance)"
            spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
            if spread[1] < 0.02 * spread[0]:
                reason += "; the points are on one line"
        else:
            order = 2 * tuple(RADIAL).index(name) + 3 if name in RADIAL else 0
            shift = own * corner_radius(fit.camera) ** order * (fit.camera.fx if order else 1.0)
            limit = MAX_LENS_SHIFT * diagonal(fit.camera)
            excess, reason = shift / limit, f"{own:.2g}, {shift:.0f} px at the image's corner (limit {limit:.0f} px)"
        if name not in known and excess > max(1.0, worst[0] if worst else 0.0):
            remedy = f"mark points that differ more in distance and place in the image{instead}"
            worst = excess, name, f"its sigma would be {reason}: {remedy}"
    if worst is not None:
        return worst[1], worst[2]
    turn = float(np.degrees(np.sqrt(np.linalg.eigvalsh(fit.covariance[:3, :3]).max())))
    if turn <= MAX_ANGLE_SIGMA_DEG:
        return None
    loose = [name for name in free if name not in known]
    if loose:
        name = "position" if "position" in loose else loose[-1]
        return name, f"with it the angles' sigma would be {turn:.2g} degrees (limit {MAX_ANGLE_SIGMA_DEG:g})"
    if free:
        return None
    raise PoseError(
        f"the camera's angles do not follow from the control points {', '.join(points.names)}: sigma {turn:.2g} "
        f"degrees (limit {MAX_ANGLE_SIGMA_DEG:g}); mark points further apart in the image, and check their pixels"
    )
