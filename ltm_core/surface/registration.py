"""Register a frame to the reference: correct its rotation, within the pose's covariance, by stable ground.

To first order, turning the camera by the small rotation w about the map's axes moves the height of a point p from the
camera by w.(p x n) / n_z (n: normal of the surface). The turn is the maximum of the posterior: robust (Cauchy)
residuals of open ground, and the pose's covariance as the prior. Canopy takes no part, because its growth over a whole
view would look like a turned camera."""

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array
from ltm_core.geometry.pose import Pose, matrix_of_vector
from ltm_core.surface.observation import DepthFrame
from ltm_core.surface.observation_kernel import ObservationLimits
from ltm_core.surface.reference_surface import BLOCK, LEAST_INCIDENCE, Reference
from ltm_core.tracing import TerrainTracer

OPEN_BELOW = 0.5
"""Canopy height in metres below which ground is open."""
_SAMPLES = 10_000
_LEAST_SAMPLES = 300
_INDEPENDENT = 100
"""Number of independent samples of one image; a network's errors cover whole regions."""
_CAUCHY = 2.0
_ROUNDS = 3
_FLOOR_DEG = 0.005
"""Minimum standard deviation of an angle in degrees from one image."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Registration of a frame. `turned_deg`: by how much. `pose`, `covariance`: afterwards. `samples`: on open ground.
    `residual`: metres of height error of these before and after, robust standard deviations."""

    turned_deg: float
    pose: Pose
    covariance: Float64Array
    samples: int
    residual: tuple[float, float]


def register(
    frame: DepthFrame, covariance: Float64Array, reference: Reference, tracer: TerrainTracer, limits: ObservationLimits
) -> Registration | None:
    """Turn a frame; return None if the pose is accurate enough, if too little open ground is in view, or if no turn
    improves it. Open ground: where the known canopy is low, or by the frame's labels. Raises PoseError as the tracer
    does."""
    prior = covariance[3:, 3:]
    if math.sqrt(float(np.trace(prior))) <= 2 * math.radians(_FLOOR_DEG):
        return None
    if not reference.canopy_known and frame.stable is None:
        return None
    step = max(1, round(math.sqrt(frame.depth.size / _SAMPLES)))
    camera = frame.camera.scaled(step)
    forward = camera.rays()[..., 2]
    measured = frame.measured[::step, ::step] & np.isfinite(frame.depth[::step, ::step])
    if frame.stable is not None:
        measured = measured & frame.stable[::step, ::step]
    ranges = (frame.depth[::step, ::step] / forward).astype(np.float32)
    sigmas = (frame.sigma[::step, ::step] / forward).astype(np.float32)
    # With a singular prior (an angle that is known), the inverse stays finite.
    information = np.linalg.inv(prior + np.eye(3) * math.radians(_FLOOR_DEG) ** 2)
    pose, total, before, samples = frame.pose, np.zeros(3), math.nan, 0
    for turn in range(_ROUNDS + 1):
        try:
            traced = tracer.trace(camera, pose, "pyramid")
        except PoseError:
            return None
        off, sigma, lever = _residuals(traced.range, ranges, sigmas, measured, camera.rays(), pose, reference, limits)
        if len(off) < _LEAST_SAMPLES:
            return None
        spread = 1.4826 * float(np.median(np.abs(off)))
        if turn == 0:
            before, samples = spread, len(off)
        weight = _INDEPENDENT / len(off) / (sigma**2 * (1 + (off / (_CAUCHY * sigma)) ** 2))
        normal = (lever * weight[:, None]).T @ lever + information
        if turn == _ROUNDS:
            break
        small = -np.linalg.solve(normal, (lever * weight[:, None]).T @ off + information @ total)
        total = total + small
        rotation = matrix_of_vector(total) @ frame.pose.rotation
        pose = Pose(frame.pose.position, rotation)
        if float(np.linalg.norm(small)) < math.radians(_FLOOR_DEG) / 5:
            break
    if spread > before or float(total @ information @ total) > limits.gate**2 * 3:
        return None
    posterior = covariance.copy()
    posterior[3:, 3:] = np.linalg.inv(normal) + np.eye(3) * math.radians(_FLOOR_DEG) ** 2
    posterior[:3, 3:] = posterior[3:, :3] = 0.0
    return Registration(math.degrees(float(np.linalg.norm(total))), pose, posterior, samples, (before, spread))


def _residuals(
    expected: Float32Array,
    ranges: Float32Array,
    sigmas: Float32Array,
    measured: BoolArray,
    rays: Float64Array,
    pose: Pose,
    reference: Reference,
    limits: ObservationLimits,
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the heights by which open ground is off (N,), their sigmas (N,), and what a turn does to them (N, 3)."""
    with np.errstate(invalid="ignore"):
        used = measured & np.isfinite(expected) & (expected < limits.max_range) & (ranges > limits.min_range)
        used &= np.isfinite(sigmas) & (sigmas > 0) & (ranges < 2 * expected)
    directions = rays[used] @ pose.rotation.T
    way = expected[used].astype(np.float64)
    lever = directions * way[:, None]
    geometry = reference.geometry
    row, col = geometry.cell_of(pose.position[0] + lever[:, 0], pose.position[1] + lever[:, 1])
    inside = geometry.contains(row, col)
    row, col = np.where(inside, row, 0), np.where(inside, col, 0)
    open_ground = inside
    if reference.canopy_known:
        with np.errstate(invalid="ignore"):
            open_ground = inside & (reference.surface[row, col] - reference.bare[row, col] < OPEN_BELOW)
    east = reference.slopes.east[row // BLOCK, col // BLOCK].astype(np.float64)
    north = reference.slopes.north[row // BLOCK, col // BLOCK].astype(np.float64)
    normal = np.stack([-east, -north, np.ones_like(east)], axis=-1)
    incidence = np.maximum(np.abs(np.sum(directions * normal, axis=-1)), LEAST_INCIDENCE)
    off = -(ranges[used] - way) * incidence
    sigma = np.hypot(sigmas[used] * incidence, limits.own_sigma)
    effect = np.cross(lever, normal)
    return off[open_ground], sigma[open_ground], effect[open_ground]
