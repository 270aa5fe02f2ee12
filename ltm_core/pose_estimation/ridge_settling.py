"""Settles a pose on the ridges in its picture, whose errors neighbouring places share.

What grows on a ridge stands over the DEM by metres, and by nearly as much a few metres on. Where that is left aside
(`pose_refinement`: places within a correlation length count as one), a stand of trees pulls a pose as hard as the
ground does. Here errors are a Gaussian process over the ground, so that the shape of a ridge counts for more than its
height: least squares whitened by the covariance of all places with each other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.pose_estimation.contour_scores import ContourDirections
from ltm_core.pose_estimation.picture_evidence import PictureEvidence
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig, SettlingConfig
from ltm_core.pose_estimation.pose_observations import RidgeObservations, ridge_observations
from ltm_core.pose_estimation.pose_prior import PosePrior
from ltm_core.pose_estimation.pose_refinement import FEWEST, RefinedPose, fitting, refine
from ltm_core.pose_estimation.terrain_horizon import TerrainHorizon
from ltm_core.types import Float64Array

_ROUNDS = ((5.0, 1.0),) * 3 + ((3.0, 1.0),) * 6
"""As `pose_refinement.ROUNDS`."""
_LEAST_FITTING = 0.02
"""Edges that fit less are left out: they would cost time and say nothing."""


def settled_on_ridges(
    refined: RefinedPose,
    evidence: PictureEvidence,
    horizon: TerrainHorizon,
    prior: PosePrior,
    focal_sigma: float,
    config: PicturePoseConfig,
) -> RefinedPose:
    """The same picture's pose by ridges alone, the DEM's own horizon among them; with its skyline's fit as it was."""
    ridges = ContourDirections.of(horizon, config.contours.nearest, with_horizon=True)
    around = ridges.in_view(refined.pose, refined.camera, config.settling.most_points)
    unseen = replace(evidence, skyline=None)
    found = refine(
        refined.pose, refined.camera, unseen, horizon, around, prior, focal_sigma, config, _ROUNDS, ridge_system
    )
    return replace(found, covariance=config.settling.doubt * found.covariance, skyline=refined.skyline)


def ridge_system(
    pose: Pose,
    camera: Camera,
    evidence: PictureEvidence,
    horizon: TerrainHorizon,
    ridges: ContourDirections,
    search: float,
    wide: float,
    config: PicturePoseConfig,
    expected: bool = False,
) -> tuple[Float64Array, Float64Array]:
    """As `picture_system`, of ridges alone, with what neighbouring places share."""
    normal, gradient = 1e-12 * np.eye(7), np.zeros(7)
    rows = ridge_observations(pose, camera, evidence, ridges, horizon.position, search, config)
    if rows is None:
        return normal, gradient
    fits = fitting(rows, config.contours.odds(search), expected)
    kept = np.flatnonzero((rows.weight > 0) & (fits > _LEAST_FITTING))
    if len(kept) < FEWEST:
        return normal, gradient
    rows = rows.only(kept)
    root = np.linalg.cholesky(shared_covariance(rows, fits[kept], config.settling))
    whitened = solve_triangular(root, np.column_stack([rows.slopes, rows.error]), lower=True, check_finite=False)
    slopes, error = whitened[:, :7], whitened[:, 7]
    return normal + slopes.T @ slopes, slopes.T @ error


def shared_covariance(rows: RidgeObservations, fits: Float64Array, config: SettlingConfig) -> Float64Array:
    """(N, N), px^2, of the errors of `rows`, each of which `fits` (N,) so far: what does not is as unsure as it is
    unlikely, by itself."""
    x, y = rows.ground.T
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    together = config.share * np.exp(-apart / config.stand) + (1 - config.share) * np.exp(-apart / config.plant)
    covariance = rows.shared[:, None] * rows.shared * together
    own = rows.sigma**2 - rows.shared**2 + np.maximum(1 / np.maximum(fits, 1e-3) - 1, 0.0) * rows.sigma**2
    covariance[np.diag_indices(len(own))] += own
    return np.asarray(covariance, np.float64)
