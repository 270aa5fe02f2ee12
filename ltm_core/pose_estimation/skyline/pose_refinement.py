"""Refine a pose by least squares over the skyline and the ridges of a photo, from a start within about a degree.

Unknowns: rotations about the map's x, y, z (rad), where they are not held shifts along them (m), and where it is free
the logarithm of the focal length. The prior pose takes part with its sigmas. Weights are those of `skyline_search`.

A pose may then settle on the ridges alone. What grows on a ridge stands over the DEM by metres, and by nearly as much a
few metres on. Where that is left aside, a stand of trees pulls a pose as hard as the ground does. There errors are a
Gaussian process over the ground, so that the shape of a ridge counts for more than its height."""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its parts when they are first used

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, pose_covariance, pose_sigmas
from ltm_core.pose_estimation.skyline.contour_scores import ContourDirections
from ltm_core.pose_estimation.skyline.picture_pose_config import FLOOR_DEG, SkylineErrors
from ltm_core.pose_estimation.skyline.pose_observations import (
    Observations,
    PoseProblem,
    RidgeObservations,
    ridge_observations,
    skyline_observations,
)
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angle_slopes, turned
from ltm_core.pose_estimation.skyline.skyline_search import column_weight

# Pixels at width 640 within which an edge is sought about a ridge, and by which sigmas of the skyline are widened.
ROUNDS = ((14.0, 3.0), (10.0, 2.0), (7.0, 1.5), (5.0, 1.0), (4.0, 1.0), (3.0, 1.0), (3.0, 1.0), (3.0, 1.0))
MOST_FOCAL_STEP = 0.05  # maximum step of the focal length's logarithm in one round
FEWEST = 6  # minimum number of places of a skyline or of ridges
_EDGE_OUTLIERS = 0.5  # share of ridge points whose nearest edge is something else
_TELLING = 0.02  # standard deviation in radians above which a column does not support a pose
_LEAST_TOLD = 1 / 3  # minimum share of a skyline that the DEM's horizon must cover to count as support
_MOST_SQUARE = 9.0  # maximum squared error of a column in sigmas; columns further off show something else


@dataclass(frozen=True)
class SkylineFit:
    """How a photo's skyline lies on the terrain's. `support`: the share of its columns that fit, of those that are not
    taken for land beyond the DEM; `veiled`: that where a nearer crest may hide the horizon; `open`: that where such
    land may stand over it. `variance`: the square of what columns that fit err by, over that of their sigmas."""

    cost: float = 0.0
    support: float = 0.0
    veiled: float = 0.0
    variance: float = 1.0
    open: float = 0.0


@dataclass(frozen=True, eq=False)
class RefinedPose:
    """`covariance`: (7, 7) of x, y, z (m), rotations about them (rad) and the logarithm of the focal length. `cost`: of
    skyline and prior. `skyline`: how that of the photo lies on the terrain's."""

    pose: Pose
    camera: Camera
    covariance: Float64Array
    cost: float
    skyline: SkylineFit

    @property
    def sigma_deg(self) -> tuple[float, float, float]:
        """Return the sigmas of azimuth, pitch and roll in degrees."""
        azimuth, pitch, roll = pose_sigmas(self.pose, self.covariance[:6, :6])[3:].tolist()
        return azimuth, pitch, roll


def refine(
    start: Pose,
    camera: Camera,
    problem: PoseProblem,
    ridges: ContourDirections,
    rounds: tuple[tuple[float, float], ...] = ROUNDS,
    alone: bool = False,
) -> RefinedPose:
    """Refine `start` by the skyline and `ridges`; `alone`: by ridges whose neighbouring places share errors."""
    system = ridge_system if alone else picture_system
    prior, focal_sigma = problem.prior, problem.focal_sigma
    pose, focal = start, math.log(camera.fx / problem.evidence.camera.fx)
    free = np.concatenate([prior.sigmas[:3] > 0, [True] * 3, [focal_sigma > 0]])
    for search, wide in rounds:
        normal, gradient = system(pose, camera, problem, ridges, search, wide)
        normal, gradient = _with_prior(normal, gradient, pose, prior, focal, focal_sigma)
        step = np.zeros(7)
        step[free] = np.linalg.solve(normal[np.ix_(free, free)], -gradient[free])
        step[3:6] *= min(1.0, math.radians(3.0) / max(float(np.linalg.norm(step[3:6])), 1e-12))
        step[6] = min(max(step[6], -MOST_FOCAL_STEP), MOST_FOCAL_STEP)
        pose = turned(pose, step[3:6], step[:3])
        focal += step[6]
        camera = camera.zoomed(math.exp(step[6]))
    normal, gradient = system(pose, camera, problem, ridges, rounds[-1][0], 1.0, True)
    fit = skyline_fit(pose, camera, problem)
    normal, _ = _with_prior(normal / fit.variance, gradient, pose, prior, focal, focal_sigma)
    covariance = np.zeros((7, 7))
    covariance[np.ix_(free, free)] = np.linalg.inv(normal[np.ix_(free, free)])
    covariance[3:6, 3:6] += pose_covariance(pose, 0.0, 0.0, *FLOOR_DEG)[3:, 3:]
    deviation = prior.deviation(pose) / np.where(prior.sigmas > 0, prior.sigmas, np.inf)
    cost = fit.cost + 0.5 * float(deviation @ deviation)
    if focal_sigma > 0:
        cost += 0.5 * (focal / focal_sigma) ** 2
    return RefinedPose(pose, camera, covariance, cost, fit)


def skyline_fit(pose: Pose, camera: Camera, problem: PoseProblem) -> SkylineFit:
    """Return the fit of a photo's skyline alone."""
    rows = skyline_observations(pose, camera, problem, 1.0)
    skyline = problem.evidence.skyline
    if rows is None or skyline is None:
        return SkylineFit()
    square = (rows.error / rows.sigma) ** 2
    q = 1 + square / 4
    odds = SkylineErrors.odds * camera.fy / rows.sigma
    like = odds / q**2.5
    fits = rows.weight > 0
    cost = -column_weight(skyline, camera, SkylineErrors.independent) * float(np.log1p(like)[fits].sum())
    inlier = like / (1 + like)
    # A crest so near, or so uncertain, that anything fits says nothing.
    supports = inlier * (rows.sigma < _TELLING * camera.fy)
    counted = rows.weight * inlier
    stated = SkylineErrors.stated
    variance = (stated + float(counted @ np.minimum(square, _MOST_SQUARE))) / (stated + counted.sum())
    told = len(skyline.u) * max(1.0 - rows.free, _LEAST_TOLD)
    return SkylineFit(cost, float(supports[fits].sum()) / told, rows.veiled, float(variance), rows.open)


def _with_prior(
    normal: Float64Array, gradient: Float64Array, pose: Pose, prior: PosePrior, focal: float, focal_sigma: float
) -> tuple[Float64Array, Float64Array]:
    slopes = np.zeros((6, 7))
    slopes[:3, :3] = np.eye(3)
    slopes[3:, 3:6] = angle_slopes(pose)
    inverse = np.where(prior.sigmas > 0, 1.0 / np.maximum(prior.sigmas, 1e-9) ** 2, 0.0)
    if not prior.heading_known:
        inverse[3] = 0.0
    normal = normal + (slopes.T * inverse) @ slopes
    gradient = gradient + (slopes.T * inverse) @ prior.deviation(pose)
    if focal_sigma > 0:
        normal[6, 6] += 1 / focal_sigma**2
        gradient[6] += focal / focal_sigma**2
    return normal, gradient


def picture_system(
    pose: Pose,
    camera: Camera,
    problem: PoseProblem,
    ridges: ContourDirections,
    search: float,
    wide: float,
    expected: bool = False,
) -> tuple[Float64Array, Float64Array]:
    """Return the normal matrix (7, 7) and gradient (7,) of the image's cost."""
    normal, gradient = 1e-12 * np.eye(7), np.zeros(7)
    skyline = skyline_observations(pose, camera, problem, wide)
    contours = ridge_observations(pose, camera, problem, ridges, search)
    for rows, odds in ((skyline, SkylineErrors.odds * camera.fy), (contours, _edge_odds(search))):
        if rows is None or len(rows.error) < FEWEST:
            continue
        weight = rows.weight * fitting(rows, odds, expected) / rows.sigma**2
        normal += (rows.slopes.T * weight) @ rows.slopes
        gradient += rows.slopes.T @ (weight * rows.error)
    return normal, gradient


def _edge_odds(search: float) -> float:
    """Return the ratio as `SkylineErrors.odds`, for a sigma of one pixel and edges within `search` pixels."""
    return (1 - _EDGE_OUTLIERS) / _EDGE_OUTLIERS * 0.75 * search


def fitting(rows: Observations, odds: float, expected: bool) -> Float64Array:
    """Return the weight of each of `rows` (N,) as fitting; `odds`: against an outlier, in one sigma of a pixel."""
    q = 1 + (rows.error / rows.sigma) ** 2 / 4
    like = odds / rows.sigma / q**2.5
    # While iterating, the weights of Student's expectation maximisation. In the covariance none: his information, 5/7
    # of this, would state more than images err by.
    return np.asarray(like / (1 + like) * (1.0 if expected else 1.25 / q), np.float64)


_ROUNDS = ((5.0, 1.0),) * 3 + ((3.0, 1.0),) * 6  # rounds as in `pose_refinement.ROUNDS`
_SHARE = 0.6  # share of the variance of the cover on a ridge that plants of a stand have in common
_STAND, _PLANT = 150.0, 5.0  # correlation lengths of that part, and of the remaining one: the shape of single plants, m
_DOUBT = 2.0  # factor on the variance of a settled pose, because some edges belong to something else
_MOST_POINTS = 250  # maximum number of ridge points in a view; all are compared with each other
_LEAST_FITTING = 0.02  # minimum fit of an edge; others cost time and add nothing


def settled_on_ridges(refined: RefinedPose, problem: PoseProblem) -> RefinedPose:
    """Return the image's pose by ridges alone, including the DEM's own horizon; the skyline's fit is kept."""
    ridges = ContourDirections.of(problem.horizon, with_horizon=True)
    around = ridges.in_view(refined.pose, refined.camera, _MOST_POINTS)
    unseen = replace(problem, evidence=replace(problem.evidence, skyline=None))
    found = refine(refined.pose, refined.camera, unseen, around, _ROUNDS, alone=True)
    return replace(found, covariance=_DOUBT * found.covariance, skyline=refined.skyline)


def ridge_system(
    pose: Pose,
    camera: Camera,
    problem: PoseProblem,
    ridges: ContourDirections,
    search: float,
    wide: float,
    expected: bool = False,
) -> tuple[Float64Array, Float64Array]:
    """Return the system as `picture_system`, of ridges alone, with the errors shared by neighbouring places."""
    normal, gradient = 1e-12 * np.eye(7), np.zeros(7)
    rows = ridge_observations(pose, camera, problem, ridges, search)
    if rows is None:
        return normal, gradient
    fits = fitting(rows, _edge_odds(search), expected)
    kept = np.flatnonzero((rows.weight > 0) & (fits > _LEAST_FITTING))
    if len(kept) < FEWEST:
        return normal, gradient
    rows = rows.only(kept)
    root = np.linalg.cholesky(shared_covariance(rows, fits[kept]))
    columns = np.column_stack([rows.slopes, rows.error])
    whitened = scipy.linalg.solve_triangular(root, columns, lower=True, check_finite=False)
    slopes, error = whitened[:, :7], whitened[:, 7]
    return normal + slopes.T @ slopes, slopes.T @ error


def shared_covariance(rows: RidgeObservations, fits: Float64Array) -> Float64Array:
    """Return (N, N), px^2, the covariance of the errors of `rows`, larger for those that hardly fit (`fits`, N)."""
    x, y = rows.ground.T
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    together = _SHARE * np.exp(-apart / _STAND) + (1 - _SHARE) * np.exp(-apart / _PLANT)
    covariance = rows.shared[:, None] * rows.shared * together
    own = rows.sigma**2 - rows.shared**2 + np.maximum(1 / np.maximum(fits, 1e-3) - 1, 0.0) * rows.sigma**2
    covariance[np.diag_indices(len(own))] += own
    return np.asarray(covariance, np.float64)
