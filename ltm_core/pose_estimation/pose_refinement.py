"""Least squares of a pose over a photo's skyline and the ridges within it, from a start that is right but for a degree.

Unknowns: rotations about the map's x, y, z (rad), where they are not held shifts along them (m), and where it is free
the logarithm of the focal length. The prior pose takes part with its sigmas. Weights are those of `skyline_search`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.pose_covariance import pose_covariance
from ltm_core.pose_estimation.contour_scores import ContourDirections
from ltm_core.pose_estimation.image_contours import ORIENTATIONS, ImageContours
from ltm_core.pose_estimation.image_skyline import ImageSkyline
from ltm_core.pose_estimation.picture_pose_config import FLOOR_DEG, ContourConfig, PicturePoseConfig
from ltm_core.pose_estimation.pose_prior import PosePrior, angle_slopes, turned
from ltm_core.pose_estimation.skyline_search import column_weight
from ltm_core.pose_estimation.terrain_horizon import TerrainHorizon
from ltm_core.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.vision.labels import Label

# Pixels at width 640 within which an edge is sought about a ridge, and by which sigmas of the skyline are widened.
ROUNDS = ((14.0, 3.0), (10.0, 2.0), (7.0, 1.5), (5.0, 1.0), (4.0, 1.0), (3.0, 1.0), (3.0, 1.0), (3.0, 1.0))
_TELLING = 0.02
"""Radians: columns of a larger sigma do not support a pose."""


@dataclass(frozen=True, eq=False)
class PictureEvidence:
    """What a photo, undistorted and in its working size, shows: `skyline` (None: no sky in it), `edges`, and the
    labels (H, W) that tell what grows on a ridge. `find_edges`: gives edges in a picture so many pixels wide."""

    camera: Camera
    labels: UInt8Array
    skyline: ImageSkyline | None
    find_edges: Callable[[int], ImageContours]
    config: ContourConfig

    @cached_property
    def edges(self) -> ImageContours:
        """To which ridges are laid."""
        return self.find_edges(self.config.width)

    @cached_property
    def coarse_edges(self) -> ImageContours:
        """By which poses are compared: who only tracks a pose never needs them."""
        return self.find_edges(self.config.coarse_width)

    @property
    def plants(self) -> float:
        """The share of trees and shrubs in the land."""
        land = self.labels != np.uint8(Label.SKY)
        grown = (self.labels == np.uint8(Label.TREE)) | (self.labels == np.uint8(Label.SHRUB))
        return float(grown.sum()) / max(float(land.sum()), 1.0)


@dataclass(frozen=True, eq=False)
class RefinedPose:
    """`information`: (7, 7) of the picture alone over x, y, z (m), rotations about them (rad) and the logarithm of the
    focal length; `gradient`: (7,) of its cost there. `cost`: of skyline and prior. `support`: the share of the skyline
    that fits; `veiled`: the share where a nearer crest may hide the horizon.
    """

    pose: Pose
    camera: Camera
    information: Float64Array
    gradient: Float64Array
    covariance: Float64Array
    cost: float
    support: float
    veiled: float


@dataclass(frozen=True, eq=False)
class _Rows:
    """Linearised observations: `error` (N,) px, its `slopes` (N, 7), `sigma` and `weight` (N,). `veiled`: the share
    of the skyline's columns where a nearer crest stands so close below the horizon that its trees may hide it.
    """

    error: Float64Array
    slopes: Float64Array
    sigma: Float64Array
    weight: Float64Array
    veiled: float = 0.0


def refine(
    start: Pose,
    camera: Camera,
    evidence: PictureEvidence,
    horizon: TerrainHorizon,
    ridges: ContourDirections,
    prior: PosePrior,
    focal_sigma: float,
    config: PicturePoseConfig,
    rounds: tuple[tuple[float, float], ...] = ROUNDS,
) -> RefinedPose:
    """Refine `start`. `focal_sigma`: of the focal length's logarithm; 0 holds it."""
    pose, focal = start, 0.0
    free = np.concatenate([prior.sigmas[:3] > 0, [True] * 3, [focal_sigma > 0]])
    for search, wide in rounds:
        normal, gradient = picture_system(pose, camera, evidence, horizon, ridges, search, wide, config)
        normal, gradient = _with_prior(normal, gradient, pose, prior, focal, focal_sigma)
        step = np.zeros(7)
        step[free] = np.linalg.solve(normal[np.ix_(free, free)], -gradient[free])
        step[3:6] *= min(1.0, math.radians(3.0) / max(float(np.linalg.norm(step[3:6])), 1e-12))
        step[6] = min(max(step[6], -0.05), 0.05)
        pose = turned(pose, step[3:6], step[:3])
        focal += step[6]
        camera = replace(camera, fx=camera.fx * math.exp(step[6]), fy=camera.fy * math.exp(step[6]))
    information, gradient = picture_system(
        pose, camera, evidence, horizon, ridges, rounds[-1][0], 1.0, config, expected=True
    )
    normal, _ = _with_prior(information, gradient, pose, prior, focal, focal_sigma)
    covariance = np.zeros((7, 7))
    covariance[np.ix_(free, free)] = np.linalg.inv(normal[np.ix_(free, free)])
    covariance[3:6, 3:6] += pose_covariance(pose, 0.0, 0.0, *FLOOR_DEG)[3:, 3:]
    cost, support, veiled = skyline_cost(pose, camera, evidence, horizon, config)
    deviation = prior.deviation(pose) / np.where(prior.sigmas > 0, prior.sigmas, np.inf)
    cost += 0.5 * float(deviation @ deviation)
    return RefinedPose(pose, camera, information, gradient, covariance, cost, support, veiled)


def skyline_cost(
    pose: Pose, camera: Camera, evidence: PictureEvidence, horizon: TerrainHorizon, config: PicturePoseConfig
) -> tuple[float, float, float]:
    """Cost of the skyline alone, the share of its columns that fit, and that where a crest may hide the horizon."""
    rows = _skyline_rows(pose, camera, evidence, horizon, 1.0, config)
    if rows is None:
        return 0.0, 0.0, 0.0
    noise = config.skyline
    q = 1 + (rows.error / rows.sigma) ** 2 / 4
    odds = noise.odds * camera.fy / rows.sigma
    like = odds / q**2.5
    fits = rows.weight > 0
    share = column_weight(evidence.skyline, camera, noise) if evidence.skyline is not None else 0.0
    cost = -share * float(np.log1p(like)[fits].sum())
    # A crest so near, or so uncertain, that anything fits says nothing.
    inlier = like / (1 + like) * (rows.sigma < _TELLING * camera.fy)
    total = len(evidence.skyline.u) if evidence.skyline is not None else 1
    return cost, float(inlier[fits].sum()) / max(total, 1), rows.veiled


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
    evidence: PictureEvidence,
    horizon: TerrainHorizon,
    ridges: ContourDirections,
    search: float,
    wide: float,
    config: PicturePoseConfig,
    expected: bool = False,
) -> tuple[Float64Array, Float64Array]:
    """Normal matrix (7, 7) and gradient (7,) of the picture's cost."""
    normal, gradient = 1e-12 * np.eye(7), np.zeros(7)
    skyline = _skyline_rows(pose, camera, evidence, horizon, wide, config)
    contours = _contour_rows(pose, camera, evidence, ridges, horizon.position, search, config)
    shares = (
        config.skyline.odds * camera.fy,
        (1 - config.contours.outliers) / config.contours.outliers * 0.75 * search,
    )
    for rows, odds in zip((skyline, contours), shares, strict=True):
        if rows is None or len(rows.error) < 6:
            continue
        q = 1 + (rows.error / rows.sigma) ** 2 / 4
        like = odds / rows.sigma / q**2.5
        weight = rows.weight * like / (1 + like) / rows.sigma**2
        # In the covariance, Student's information; while iterating, the weights of its expectation maximisation.
        weight = weight * (5 / 7 if expected else 1.25 / q)
        normal += (rows.slopes.T * weight) @ rows.slopes
        gradient += rows.slopes.T @ (weight * rows.error)
    return normal, gradient


def _projected(
    directions: Float64Array, ranges: Float64Array, pose: Pose, camera: Camera, origin: Float64Array
) -> tuple[Float64Array, Float64Array, BoolArray]:
    """Pixels (M, 2) of terrain in directions seen from `origin`, their slopes (M, 2, 7), and which lie in front."""
    shift = (pose.position - origin) / np.maximum(ranges, 1.0)[:, None]
    at = directions - shift
    optical = at @ pose.rotation
    ahead = optical[:, 2] > 0.05
    x, y, z = optical.T
    z = np.where(ahead, z, 1.0)
    pixels = np.column_stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])
    zero = np.zeros_like(z)
    lens = np.empty((len(z), 2, 3))
    lens[:, 0] = np.column_stack([camera.fx / z, zero, -camera.fx * x / z**2])
    lens[:, 1] = np.column_stack([zero, camera.fy / z, -camera.fy * y / z**2])
    by_direction = lens @ pose.rotation.T
    slopes = np.empty((len(z), 2, 7))
    slopes[..., :3] = -by_direction / np.maximum(ranges, 1.0)[:, None, None]
    # A turn w of the camera moves a direction d by -w x d = d x w, seen from the camera.
    for axis in range(3):
        unit = np.zeros(3)
        unit[axis] = 1.0
        slopes[..., 3 + axis] = np.einsum("mij,mj->mi", by_direction, -np.cross(unit, at))
    slopes[..., 6] = pixels - np.array([camera.cx, camera.cy])
    return pixels, slopes, ahead


def _skyline_rows(
    pose: Pose,
    camera: Camera,
    evidence: PictureEvidence,
    horizon: TerrainHorizon,
    wide: float,
    config: PicturePoseConfig,
) -> _Rows | None:
    """Row of the terrain's skyline minus that of the photo's, column by column; None where there is none."""
    skyline, noise = evidence.skyline, config.skyline
    if skyline is None or len(skyline.u) < 8:
        return None
    azimuths = horizon.azimuths
    middle = math.radians(pose.angles_deg[0])
    away = (azimuths - middle + math.pi) % (2 * math.pi) - math.pi
    half = math.atan(max(camera.cx, camera.width - camera.cx) / camera.fx) + math.radians(8.0)
    seen = np.flatnonzero((np.abs(away) < half) & (horizon.range > 0))
    seen = seen[np.argsort(away[seen])]
    if len(seen) < 8:
        return None
    t, r = horizon.tangent[seen], horizon.range[seen]
    directions = np.column_stack([np.sin(azimuths[seen]), np.cos(azimuths[seen]), t])
    pixels, slopes, ahead = _projected(directions, r, pose, camera, horizon.position)
    # To the right only: where a roll folds the horizon back on itself, the first of it.
    forward = ahead & (pixels[:, 0] > np.concatenate([[-np.inf], np.maximum.accumulate(pixels[:-1, 0])]))
    pixels, slopes, t, r, seen = pixels[forward], slopes[forward], t[forward], r[forward], seen[forward]
    if len(r) < 8:
        return None
    right = np.searchsorted(pixels[:, 0], skyline.u)
    inside = (right > 0) & (right < len(r))
    right = np.clip(right, 1, len(r) - 1)
    left = right - 1
    span = pixels[right, 0] - pixels[left, 0]
    part = (skyline.u - pixels[left, 0]) / span
    steep = (pixels[right, 1] - pixels[left, 1]) / span
    near = np.where(r[left] < r[right], left, right)
    ranges, cells = r[near], horizon.cell[seen][near]
    v = pixels[left, 1] + part * (pixels[right, 1] - pixels[left, 1])
    down = slopes[left] + part[:, None, None] * (slopes[right] - slopes[left])
    cover = noise.cover.table()[skyline.cover]
    metre = camera.fy / ranges
    lift, uneven = noise.cell_lift * cells, noise.cell_share * cells
    v = v - (cover[:, 0] + lift) * metre
    # Negative: terrain where the photo has sky. Positive: open land may stand there instead.
    error = v - skyline.v
    above = np.maximum(0.0, (horizon.bound[seen][near] - t[near]) * camera.fy - (cover[:, 0] + lift) * metre)
    error = np.where(error < 0, error, np.maximum(0.0, error - above))
    free = (error == 0.0) & (above > 0)
    sigma = np.sqrt(
        skyline.sigma_px**2 * (1 + np.minimum(steep, 3.0) ** 2)
        + (noise.dem_sigma**2 + cover[:, 1] ** 2 + uneven**2) * metre**2
    )
    # A nearer crest just below, whose trees, or haze behind it, may hide the horizon.
    front = horizon.front_range[seen][near]
    over = camera.fy / np.where(front > 0, front, 1.0)
    fallen = (t[near] - horizon.front_tangent[seen][near]) * camera.fy + (cover[:, 0] + lift) * metre
    behind = v + fallen - cover[:, 0] * over - skyline.v
    spread = np.hypot(skyline.sigma_px, np.hypot(noise.dem_sigma, cover[:, 1]) * over)
    hidden = (front > 0) & (np.abs(behind) / spread + np.log(spread) < np.abs(error) / sigma + np.log(sigma))
    error, sigma, metre = (
        np.where(hidden, behind, error),
        np.where(hidden, spread, sigma),
        np.where(hidden, over, metre),
    )
    free &= ~hidden
    share = column_weight(skyline, camera, noise)
    weight = np.where(inside & ~free, np.minimum(share, skyline.spacing / metre / noise.correlation), 0.0)
    rows = down[:, 1] - steep[:, None] * down[:, 0]
    veiled = float(((front > 0) & inside).mean())
    return _Rows(error, rows, sigma * wide, weight, veiled)


def _contour_rows(
    pose: Pose,
    camera: Camera,
    evidence: PictureEvidence,
    ridges: ContourDirections,
    origin: Float64Array,
    search: float,
    config: PicturePoseConfig,
) -> _Rows | None:
    """From where ridges are predicted to the edge nearby, across the ridge, pixels."""
    if len(ridges.range) == 0:
        return None
    noise, edges = config.contours, evidence.edges
    pixels, slopes, ahead = _projected(ridges.here, ridges.range, pose, camera, origin)
    shift = (pose.position - origin) / ridges.range[:, None]
    after = (ridges.following - shift) @ pose.rotation
    z = np.where(after[:, 2] > 0.05, after[:, 2], 1.0)
    line = np.column_stack([camera.fx * after[:, 0] / z + camera.cx, camera.fy * after[:, 1] / z + camera.cy]) - pixels
    inside = ahead & (after[:, 2] > 0.05) & (pixels >= 2).all(axis=1)
    inside &= (pixels[:, 0] < camera.width - 3) & (pixels[:, 1] < camera.height - 3)
    kept = np.flatnonzero(inside)
    if len(kept) < 6:
        return None
    pixels, slopes, line, ranges = pixels[kept], slopes[kept], line[kept], ridges.range[kept]
    lift, uneven = config.skyline.cell_lift * ridges.cell[kept], config.skyline.cell_share * ridges.cell[kept]
    length = np.hypot(line[:, 0], line[:, 1])
    normal = np.column_stack([-line[:, 1], line[:, 0]]) / np.maximum(length, 1e-9)[:, None]
    unit = camera.width / 640.0
    below = np.clip(np.rint(pixels[:, 1] + 2 * unit), 0, camera.height - 1).astype(np.intp)
    cover = config.skyline.cover.table()[evidence.labels[below, np.rint(pixels[:, 0]).astype(np.intp)]]
    metre = camera.fy / ranges
    pixels = pixels - np.column_stack([np.zeros(len(kept)), (cover[:, 0] + lift) * metre])
    found, strength = _nearest_edges(pixels, normal, edges.response, edges.scale, search * unit, 0.5 * edges.scale)
    sigma = np.sqrt(
        (noise.sigma_px * unit) ** 2 + (config.skyline.dem_sigma**2 + cover[:, 1] ** 2 + uneven**2) * metre**2
    )
    step = ridges.every * (np.median(length[length > 0]) if (length > 0).any() else 1.0)
    correlation = np.maximum(noise.correlation_px * unit, noise.correlation * metre)
    weight = np.minimum(1.0, step / correlation) * np.minimum(strength, 2.0) / 2.0
    rows = -np.einsum("mi,mij->mj", normal, slopes)
    return _Rows(found, rows, sigma, weight)


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _nearest_edges(
    pixels: Float64Array, normal: Float64Array, response: Float32Array, scale: float, search: float, step: float
) -> tuple[Float64Array, Float64Array]:
    """How far along its normal (N, 2) the strongest edge of each pixel's direction lies, and its response."""
    height, width = response.shape[1], response.shape[2]
    found, strength = np.zeros(len(pixels)), np.zeros(len(pixels))
    for k in range(len(pixels)):
        angle = math.atan2(normal[k, 1], normal[k, 0])
        o = math.floor(angle * (ORIENTATIONS / math.pi) + 0.5) % ORIENTATIONS
        best = 0.0
        n = int(search / step)
        for i in range(-n, n + 1):
            d = i * step
            u = (pixels[k, 0] + d * normal[k, 0] + 0.5) / scale - 0.5
            v = (pixels[k, 1] + d * normal[k, 1] + 0.5) / scale - 0.5
            if u < 1 or v < 1 or u >= width - 2 or v >= height - 2:
                continue
            c, r = int(u), int(v)
            fu, fv = u - c, v - r
            value = (1 - fv) * ((1 - fu) * response[o, r, c] + fu * response[o, r, c + 1])
            value += fv * ((1 - fu) * response[o, r + 1, c] + fu * response[o, r + 1, c + 1])
            value *= math.exp(-0.5 * (d / (0.6 * search)) ** 2)
            if value > best:
                best = value
                found[k] = d
        strength[k] = best
    return found, strength
