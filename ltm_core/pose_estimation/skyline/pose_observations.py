"""Differences between a photo's skyline and edges and those predicted by the terrain from a pose, linearised about it.

Unknowns: shifts along the map's x, y, z (m), rotations about them (rad), the logarithm of the focal length. Weights are
those of `skyline_search`."""

import math
from dataclasses import dataclass, fields

import numpy as np

from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, IndexArray
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.contour_scores import ContourDirections, PictureEvidence
from ltm_core.pose_estimation.skyline.image_edges import ORIENTATIONS
from ltm_core.pose_estimation.skyline.picture_pose_config import SkylineErrors
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.pose_estimation.skyline.skyline_search import column_weight
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon

_EDGE_SIGMA_PX = 1.2  # standard deviation of an edge in pixels at width 640


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """What a pose is fitted by: the evidence in its image, the terrain from the prior position, the prior pose, and the
    standard deviation of the focal length's logarithm; 0 holds it. `along`: metres, and pixels at width 640, within
    which errors along a ridge are fully correlated; the longer of both counts."""

    evidence: PictureEvidence
    horizon: TerrainHorizon
    prior: PosePrior
    focal_sigma: float = 0.0
    along: float = 24.0


@dataclass(frozen=True, eq=False)
class Observations:
    """`error` (N,): px by which terrain lies below what the photo shows; `slopes` (N, 7), `sigma`, `weight` (N,)."""

    error: Float64Array
    slopes: Float64Array
    sigma: Float64Array
    weight: Float64Array


@dataclass(frozen=True, eq=False)
class SkylineObservations(Observations):
    """Shares of the skyline's columns. `veiled`: a nearer crest is so close below the horizon that its trees may hide
    it. `open`: land beyond the DEM may rise above the horizon. `free`: it is assumed to do so."""

    veiled: float
    open: float
    free: float


@dataclass(frozen=True, eq=False)
class RidgeObservations(Observations):
    """`shared` (N,): part of sigma that neighbouring places share, px. `ground` (N, 2): metres from the prediction."""

    shared: Float64Array
    ground: Float64Array

    def only(self, kept: IndexArray) -> "RidgeObservations":
        """Return those places (K,) only."""
        return RidgeObservations(*(getattr(self, field.name)[kept] for field in fields(self)))


def _projected(
    directions: Float64Array, ranges: Float64Array, pose: Pose, camera: Camera, origin: Float64Array
) -> tuple[Float64Array, Float64Array, BoolArray]:
    """Return pixels (M, 2) of terrain seen from `origin`, their slopes (M, 2, 7), and which lie in front."""
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    return _project(directions, ranges, pose.position - origin, pose.rotation, lens)  # type: ignore[no-any-return]


@kernel(nogil=True)
def _project(
    directions: Float64Array, ranges: Float64Array, moved: Float64Array, rotation: Float64Array, lens: Float64Array
) -> tuple[Float64Array, Float64Array, BoolArray]:
    pixels, slopes = np.empty((len(ranges), 2)), np.empty((len(ranges), 2, 7))
    ahead = np.empty(len(ranges), np.bool_)
    d, across = np.empty(3), np.empty((2, 3))
    for k in range(len(ranges)):
        far = max(ranges[k], 1.0)
        x, y, z = 0.0, 0.0, 0.0
        for i in range(3):
            d[i] = directions[k, i] - moved[i] / far
            x += d[i] * rotation[i, 0]
            y += d[i] * rotation[i, 1]
            z += d[i] * rotation[i, 2]
        ahead[k] = z > 0.05
        if not ahead[k]:
            z = 1.0
        for i in range(3):
            across[0, i] = lens[0] / z * (rotation[i, 0] - x / z * rotation[i, 2])
            across[1, i] = lens[1] / z * (rotation[i, 1] - y / z * rotation[i, 2])
        pixels[k, 0], pixels[k, 1] = lens[0] * x / z + lens[2], lens[1] * y / z + lens[3]
        for j in range(2):
            for i in range(3):
                following, last = (i + 1) % 3, (i + 2) % 3
                slopes[k, j, i] = -across[j, i] / far
                # A turn w of the camera moves a direction d by -w x d = d x w, seen from the camera; b (d x w) is
                # (b x d) w.
                slopes[k, j, 3 + i] = across[j, following] * d[last] - across[j, last] * d[following]
            slopes[k, j, 6] = pixels[k, j] - lens[2 + j]
    return pixels, slopes, ahead


def skyline_observations(pose: Pose, camera: Camera, problem: PoseProblem, wide: float) -> SkylineObservations | None:
    """Return the terrain's skyline row minus the photo's by column; None without. `wide`: factor of the sigmas."""
    skyline, horizon, noise = problem.evidence.skyline, problem.horizon, SkylineErrors
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
    height, cover_sigma = horizon.cover.at(skyline.cover, ranges)
    metre = camera.fy / ranges
    lift, uneven = noise.cell_lift * cells, noise.cell_share * cells
    v = v - (height + lift) * metre
    # Negative: terrain where the photo has sky. Positive: land beyond the DEM may stand there instead, or it is the
    # horizon after all, whichever is the likelier.
    error = v - skyline.v
    above = np.maximum(0.0, (horizon.bound[seen][near] - t[near]) * camera.fy - (height + lift) * metre)
    sigma = np.sqrt(
        skyline.sigma_px**2 * (1 + np.minimum(steep, 3.0) ** 2)
        + (noise.dem_sigma**2 + cover_sigma**2 + uneven**2) * metre**2
    )
    wider = sigma * wide
    own = noise.own_crest / wider / (1 + (error / wider) ** 2 / 4) ** 2.5
    beyond = (error > 0) & (above > 0) & (own <= (1 - noise.own_crest) / (wider + 0.375 * above))
    error = np.where(beyond, np.maximum(0.0, error - above), error)
    free = beyond & (error == 0.0)
    # A nearer crest just below, whose trees, or haze behind it, may hide the horizon.
    front = horizon.front_range[seen][near]
    over = camera.fy / np.where(front > 0, front, 1.0)
    fallen = (t[near] - horizon.front_tangent[seen][near]) * camera.fy + (height + lift) * metre
    before, before_sigma = horizon.cover.at(skyline.cover, front)
    behind = v + fallen - before * over - skyline.v
    spread = np.hypot(skyline.sigma_px, np.hypot(noise.dem_sigma, before_sigma) * over)
    hidden = (front > 0) & (np.abs(behind) / spread + np.log(spread) < np.abs(error) / sigma + np.log(sigma))
    pairs = ((behind, error), (spread, sigma), (over, metre))
    error, sigma, metre = (np.where(hidden, other, own) for other, own in pairs)
    free &= ~hidden
    share = column_weight(skyline, camera, noise.independent_fit)
    weight = np.where(inside & ~free, np.minimum(share, skyline.spacing / metre / noise.correlation), 0.0)
    rows = down[:, 1] - steep[:, None] * down[:, 0]
    veiled, open_share, taken = (float((where & inside).mean()) for where in (front > 0, above > 0, free))
    return SkylineObservations(error, rows, sigma * wide, weight, veiled, open_share, taken)


def ridge_observations(
    pose: Pose, camera: Camera, problem: PoseProblem, ridges: ContourDirections, search: float
) -> RidgeObservations | None:
    """Return the distances across ridges from the nearest edge within `search` pixels (at width 640), pixels."""
    if len(ridges.range) == 0:
        return None
    evidence, horizon, origin = problem.evidence, problem.horizon, problem.horizon.position
    edges = evidence.edges
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
    lift, uneven = SkylineErrors.cell_lift * ridges.cell[kept], SkylineErrors.cell_share * ridges.cell[kept]
    length = np.hypot(line[:, 0], line[:, 1])
    normal = np.column_stack([-line[:, 1], line[:, 0]]) / np.maximum(length, 1e-9)[:, None]
    unit = camera.width / 640.0
    below = np.clip(np.rint(pixels[:, 1] + 2 * unit), 0, camera.height - 1).astype(np.intp)
    labels = evidence.labels[below, np.rint(pixels[:, 0]).astype(np.intp)]
    height, cover_sigma = horizon.cover.at(labels, ranges)
    metre = camera.fy / ranges
    pixels = pixels - np.column_stack([np.zeros(len(kept)), (height + lift) * metre])
    found, strength = _nearest_edges(pixels, normal, edges.response, edges.scale, search * unit, 0.5 * edges.scale)
    shared = np.hypot(SkylineErrors.dem_sigma, cover_sigma) * metre
    sigma = np.sqrt((_EDGE_SIGMA_PX * unit) ** 2 + (uneven * metre) ** 2 + shared**2)
    step = ridges.every * (np.median(length[length > 0]) if (length > 0).any() else 1.0)
    correlation = problem.along * np.maximum(unit, metre)
    weight = np.minimum(1.0, step / correlation) * np.minimum(strength, 2.0) / 2.0
    rows = np.einsum("mi,mij->mj", normal, slopes)
    away = ridges.here[kept, :2]
    ground = away * (ranges / np.hypot(away[:, 0], away[:, 1]))[:, None]
    return RidgeObservations(-found, rows, sigma, weight, shared, ground)


@kernel(nogil=True)
def _nearest_edges(
    pixels: Float64Array, normal: Float64Array, response: Float32Array, scale: float, search: float, step: float
) -> tuple[Float64Array, Float64Array]:
    """Return how far along its normal (N, 2) the strongest edge of each pixel's direction lies, and its response."""
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
