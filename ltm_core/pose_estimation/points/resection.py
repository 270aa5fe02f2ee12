"""Fit a camera's angles, focal length, k1 and place to surveyed points, and check the result against the terrain.

The adjustment minimises the distances in the image: a coarse search (`control_points`), a fit with robust loss, least
squares without outliers, and a test of which parameters the points determine. Source: Luhmann et al., Close-Range
Photogrammetry, 3rd ed., 4.2.3 (space resection), 2.4 (adjustment, precision)."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import PoseError
from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import pose_sigmas
from ltm_core.pose_estimation.lens import LensPrior, RadialTrend
from ltm_core.pose_estimation.points.control_points import ControlPoints, coarse_poses
from ltm_core.pose_estimation.points.resection_adjustment import (
    LENS,
    PARAMETERS,
    Adjustment,
    Fit,
    Free,
    NoCommonPoseError,
    Parameter,
    check_fit,
    check_points,
    hold_for_redundancy,
    unbearable,
)
from ltm_core.tracing import TerrainTracer
from ltm_core.visibility.footprint import line_of_sight_vectors, pixel_rays


@dataclass(frozen=True, eq=False)
class Resection(Fit):
    """A fitted camera with its points.

    `held`: parameters that were asked for but not fitted, with the reason. `sigmas`: standard deviations by name:
    azimuth_deg, pitch_deg, roll_deg, and of the fitted ones fx, cx, cy (pixels), k1, k2, k3, x, y, z (metres).
    `pose_covariance`: (6, 6) over x, y, z (m) and rotations about the map's x, y, z (rad), as in
    geometry_msgs/PoseWithCovariance; a held position has the variance that it was given, or zero. `bending`: the first
    radial term that is not fitted, if the residuals bend with the radius."""

    points: ControlPoints
    fitted: tuple[Parameter, ...]
    held: dict[Parameter, str]
    sigmas: dict[str, float]
    pose_covariance: Float64Array
    bending: tuple[Parameter, RadialTrend] | None = None

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
    lens: LensPrior | None = None,
) -> Resection:
    """Fit the camera to the points.

    Args:
        points: control points; pixel (0, 0) is the centre of the top-left one.
        camera: start of the lens; parameters that are not free are kept, and fy / fx too.
        position: (3,) map metres: held, or roughly known where "position" is free: then all places are searched, and
            of poses that explain the points alike the nearest is taken.
        angles_deg: (azimuth, pitch, roll) where they are roughly known; they only help the search.
        free: parameters to fit besides the angles. One that the points do not determine, or with which they do not
            fit one pose, is held, with a reason.
        bend: curvature coefficient of the rays, `geodesy.ray_bend`.
        position_sigma: how well `position` is known, metres, one or three: an observation of weight 1 / sigma^2 where
            the position is free, which it then stays, and its variance where it is not.
        sigma_px: smallest standard deviation of a marked pixel; it is doubled if the points do not fit one pose.
        lens: what is known of the lens; it frees all its parameters, which are then never held.

    Raises PoseError that names the points: fewer than three, outside the image, crowded or in line so that the angles
    do not follow from them, behind the camera, or so wrong that no pose explains them."""
    unknown = [name for name in free if name not in PARAMETERS]
    if unknown:
        raise PoseError(f"cannot fit {', '.join(unknown)}: free parameters are {', '.join(PARAMETERS)}")
    if not sigma_px > 0:
        raise PoseError(f"the sigma of a marked pixel must be positive, got {sigma_px}")
    origin, sigma = np.asarray(position, np.float64), None
    if position_sigma is not None:
        sigma = np.broadcast_to(np.asarray(position_sigma, np.float64), (3,))
        if not (np.isfinite(sigma).all() and (sigma > 0).all()):
            raise PoseError(f"the position's sigma must be positive metres, got {sigma.tolist()}")
    check_points(points, camera, origin)
    problem = Adjustment(points, bend, origin, sigma, lens)
    asked = {*free, *(LENS if lens is not None else ())}
    chosen = [name for name in PARAMETERS if name in asked]
    held = hold_for_redundancy(chosen, len(points.names), problem.known)
    misfit: NoCommonPoseError | None = None
    loose: tuple[Parameter, str] | None
    while True:
        try:
            best = _rough_fit(problem, camera, angles_deg, tuple(chosen), sigma_px)
            fit = problem.robust_fit(best.pose, best.camera, tuple(chosen), sigma_px)
            fit = problem.without_outliers(fit, tuple(chosen), sigma_px)
            check_fit(points, fit)
        except NoCommonPoseError as error:
            if misfit is None:
                misfit, sigma_px = error, 2 * sigma_px
                continue
            optional = [name for name in chosen if name not in problem.known and name != "position"]
            if not optional:
                raise misfit from None
            loose = optional[-1], "with it, the points do not fit one pose"
        else:
            loose = unbearable(fit, tuple(chosen), points, problem.known)
            if loose is None:
                break
        held[loose[0]] = loose[1]
        chosen.remove(loose[0])
    bending = problem.bending(fit, tuple(chosen))
    clear = bending if bending is not None and bending[1].clear else None
    sigmas, pose_covariance = _sigmas(fit, chosen, sigma)
    return Resection(
        **vars(fit), points=points, fitted=tuple(chosen), held=held, sigmas=sigmas, pose_covariance=pose_covariance,
        bending=clear,
    )  # fmt: skip


def _rough_fit(
    problem: Adjustment,
    camera: Camera,
    angles_deg: tuple[float, float, float] | None,
    free: Free,
    sigma_px: float,
) -> Fit:
    """Return the best of the coarse search's poses, after a short fit; of those that explain the points alike, that
    whose position is nearest to the stated one."""
    kind = angles_deg, "focal" in free, "position" in free, problem.bend
    starts = coarse_poses(problem.points, camera, problem.position, *kind)
    rough = tuple(name for name in free if name in ("focal", "position"))
    fits = [problem.robust_fit(pose, start, rough, sigma_px, rounds=2) for start, pose in starts]
    alike = max(min(fit.median_px for fit in fits), sigma_px)
    near = [fit for fit in fits if fit.median_px <= alike]
    return min(near, key=lambda fit: float(np.linalg.norm(fit.pose.position - problem.position)))


def _sigmas(
    fit: Fit, fitted: Sequence[Parameter], position_sigma: Float64Array | None
) -> tuple[dict[str, float], Float64Array]:
    """Return the fields `sigmas` and `pose_covariance` of the result."""
    pose_covariance = np.zeros((6, 6))
    pose_covariance[3:, 3:] = fit.covariance[:3, :3]
    if "position" in fitted:  # the last of the parameters
        both = np.array([-3, -2, -1, 0, 1, 2])
        pose_covariance = fit.covariance[np.ix_(both, both)]
    elif position_sigma is not None:
        pose_covariance[:3, :3] = np.diag(position_sigma**2)
    axes = {"focal": ("fx",), "centre": ("cx", "cy"), "position": ("x", "y", "z")}
    names = ["azimuth_deg", "pitch_deg", "roll_deg", *(axis for name in fitted for axis in axes.get(name, (name,)))]
    own = np.sqrt(np.diag(fit.covariance))[3:].tolist()
    sigmas = dict(zip(names, [*pose_sigmas(fit.pose, pose_covariance)[3:].tolist(), *own], strict=True))
    if "fx" in sigmas:
        sigmas["fx"] *= fit.camera.fx
    return sigmas, pose_covariance


HIDDEN_BY = 5.0  # distance in metres from a surveyed point above which its ray met other ground


class SurveyedState(StrEnum):
    """State of a surveyed point in the DEM as seen from the fitted camera."""

    SEEN = "seen"
    HIDDEN = "hidden"
    """The ray aimed at the point ends before it: on other ground, or on the DEM's surface above a point below it."""
    ABOVE = "above its surface"
    """The ray passes the point: the DEM cuts off the edge or tree on which it is."""
    BESIDE = "beside the DEM"
    """No ground is known at the point or on the way to it."""


@dataclass(frozen=True, eq=False)
class TracedErrors:
    """Tracing errors. `errors`: (N,) metres from the traced to the surveyed place, +inf where the pixel meets no known
    terrain. `states`: of each point. `above_ground`: (N,) metres from the DEM's surface up to a point, NaN outside."""

    errors: Float64Array
    states: tuple[SurveyedState, ...]
    above_ground: Float64Array

    @property
    def visible(self) -> BoolArray:
        """Return (N,) whether the ray aimed at the surveyed place itself ends there."""
        return np.array([state is SurveyedState.SEEN for state in self.states])

    @property
    def met(self) -> BoolArray:
        """Return (N,) whether the marked pixel meets known terrain."""
        return np.isfinite(self.errors)


def traced_errors(result: Resection, tracer: TerrainTracer) -> TracedErrors:
    """Trace the marked sub-pixel places of all control points, outliers too."""
    pose, places = result.pose, result.points.places
    directions = pixel_rays(result.camera, result.points.pixels) @ pose.rotation.T
    ranges = tracer.trace_rays(pose.position, directions).astype(np.float64)
    with np.errstate(invalid="ignore"):
        traced = directions * ranges[:, None]
        traced[:, 2] += tracer.bend * (traced[:, 0] ** 2 + traced[:, 1] ** 2)
    errors = np.linalg.norm(traced + pose.position - places, axis=1)
    above = places[:, 2] - np.asarray(tracer.dem.elevation_at(places[:, 0], places[:, 1]), np.float64)
    sights = line_of_sight_vectors(pose.position, places, tracer.bend)
    # Metres by which rays aimed at the places end beyond them; NaN if no ground is known on the way.
    beyond = tracer.trace_rays(pose.position, sights) - np.linalg.norm(sights, axis=1)
    seen, passed = np.abs(beyond) < HIDDEN_BY, (beyond > 0) | (np.isnan(beyond) & (above > 0))
    states = SurveyedState.SEEN, SurveyedState.BESIDE, SurveyedState.ABOVE, SurveyedState.BESIDE
    found = np.select([seen, np.isnan(above), passed, np.isnan(beyond)], states, SurveyedState.HIDDEN)
    return TracedErrors(np.where(np.isfinite(errors), errors, np.inf), tuple(map(SurveyedState, found)), above)
