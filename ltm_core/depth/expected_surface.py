"""Compute the depth that the terrain and the network predict for each pixel, with its standard deviation.

The ray that meets a surface raised by h above ground of depth d is the one that meets bare ground h f / d pixels
further down the image: so the top of vegetation is found in the traced image itself, never across a silhouette."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors, ground_samples
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.scale_fit import ScaleFit, fit_scale
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import DepthImage, RangeImage


class _SurfaceRules(NamedTuple):
    """As compiled code takes them. `focal`: pixels; sigmas of direction, radians, and heights, metres."""

    focal: np.float32
    angle_sigma: np.float32
    dem_sigma: np.float32
    jump: np.float32
    cover_doubt: np.float32
    pixel_doubt: np.float32
    least: np.float32


def expected_surface(
    ground: Float32Array,
    labels: UInt8Array | None,
    cover: Float32Array,
    camera: Camera,
    pose: Pose,
    angle_sigma: float,
    dem_sigma: float,
    config: FusionConfig,
) -> tuple[Float32Array, Float32Array]:
    """Return depth and sigma of the visible surface, (H, W) float32 metres; +inf and NaN are those of `ground`.

    `ground`: traced depth along the optical axis (H, W). `labels`: class ids (H, W); None: bare ground. `cover`: (256,)
    metres above ground by class id; not used if the camera is rolled. `angle_sigma`: of the camera's direction,
    radians. `dem_sigma`: of the terrain's heights, metres. Sigma follows from the gradient of the traced depth."""
    surface, sigma = np.empty_like(ground), np.empty_like(ground)
    _, pitch, roll = pose.angles_deg
    plumb = math.cos(math.radians(pitch)) if abs(roll) <= config.surface.most_roll_deg else 0.0
    own, doubt = config.surface, config.cover.doubt
    rules = camera.fy, angle_sigma, dem_sigma, own.jump, doubt, own.pixel_doubt, own.least_sigma
    ids = np.zeros((1, 1), np.uint8) if labels is None else labels
    cover = (cover * plumb).astype(np.float32)
    _expect(ground, ids, labels is not None, cover, _SurfaceRules(*map(np.float32, rules)), surface, sigma)
    return surface, sigma


@kernel(nogil=True, fastmath={"nsz", "arcp", "contract"})
def _expect(
    ground: Float32Array,
    labels: UInt8Array,
    labelled: bool,
    cover: Float32Array,
    rules: _SurfaceRules,
    surface: Float32Array,
    sigma: Float32Array,
) -> None:
    """Process row by row in short loops without branches, which compilers turn into vector code."""
    height, width = ground.shape
    far, none = np.float32(1e9), np.float32(np.nan)
    focal, angle_sigma, dem_sigma = rules.focal, rules.angle_sigma, rules.dem_sigma
    across = rules.pixel_doubt / focal
    angle = focal * focal * (angle_sigma * angle_sigma + across * across)
    lift = focal * focal * dem_sigma * dem_sigma
    least = rules.least * rules.least
    slope = np.empty(width, np.float32)
    for v in range(height):
        here, above, below = ground[v], ground[max(v - 1, 0)], ground[min(v + 1, height - 1)]
        square = sigma[v]
        # One-sided differences, the lesser of two: a silhouette beside the pixel is no slope.
        for u in range(1, width - 1):
            a, b = abs(here[u - 1] - here[u]), abs(here[u + 1] - here[u])
            slope[u] = a if a < b else b
        slope[0], slope[width - 1] = abs(here[1] - here[0]), abs(here[width - 2] - here[width - 1])
        for u in range(width):
            d = here[u]
            a, b = abs(above[u] - d), abs(below[u] - d)
            low, high = (a, b) if a < b else (b, a)
            steep = low if low > 0 else high
            steep = steep if steep < far else np.float32(0.1) * d
            flat = slope[u] if slope[u] < far else np.float32(0.0)
            steep, flat = steep * steep, flat * flat
            total = (steep + flat) * angle + steep * (lift / (d * d)) + least * d * d
            square[u] = total if d < far else none
        if labelled:
            _cover(ground, v, labels[v], cover, rules, surface, square)
        else:
            for u in range(width):
                surface[v, u] = here[u]
        for u in range(width):
            square[u] = np.sqrt(square[u])


@helper(fastmath={"nsz", "arcp", "contract"})
def _cover(
    ground: Float32Array,
    v: int,
    labels: UInt8Array,
    cover: Float32Array,
    rules: _SurfaceRules,
    surface: Float32Array,
    square: Float32Array,
) -> None:
    """Bring row `v` of the ground to the top of its cover, into `surface`, and add its variance to `square`. The row
    above gives the first guess of the depth."""
    height, width = ground.shape
    here, above, top = ground[v], surface[max(v - 1, 0)], surface[v]
    flat = ground.reshape(-1)
    far, least, jump, focal = np.float32(1e9), np.float32(0.01), rules.jump, rules.focal
    row, last, lowest = np.float32(v), np.float32(height - 1), np.int32(height - 2)
    for u in range(width):
        d = here[u]
        top[u] = d
        reach = cover[labels[u]] * focal
        if reach > 0 and d < far and d > least:
            guess = above[u] if v > 0 else d
            if not (guess < jump * d and d < jump * guess):
                guess = d
            # Where the row above makes it leap, the ground's own depth may not: rows must not take turns.
            for _ in range(2):
                place = min(row + reach / guess, last)
                k = min(np.int32(place), lowest)
                i = np.uint32(k) * np.uint32(width) + np.uint32(u)
                below = flat[i] + (place - np.float32(k)) * (flat[i + np.uint32(width)] - flat[i])
                if below * jump > d:
                    top[u] = below
                    doubt = rules.cover_doubt * (d - below)
                    square[u] += doubt * doubt
                    break
                guess = d


@dataclass(frozen=True)
class FusionSettings:
    """Standard deviations of the inputs. angle_sigma: camera direction, radians, in addition to its pose's covariance.
    dem_sigma: terrain heights, metres."""

    angle_sigma: float = float(np.radians(0.03))
    dem_sigma: float = 1.0


def fitted(
    traced: RangeImage | DepthImage,
    network: NetworkDepth | None,
    labels: UInt8Array | None,
    classes: ClassPriors,
    settings: FusionSettings,
    config: FusionConfig,
) -> tuple[Float32Array, Float32Array, ScaleFit | None]:
    """Return depth and sigma (H, W) of the surface that the terrain and the height of what grows there predict, and the
    network's scale from trustworthy ground (pixel sampling and RANSAC regression) with its errors there."""
    sigmas = settings.angle_sigma, settings.dem_sigma
    depth, sigma = expected_surface(traced.depth(), labels, classes.cover, traced.camera, traced.pose, *sigmas, config)
    if network is None:
        return depth, sigma, None
    samples = ground_samples(depth, sigma, labels, classes.ground, traced.camera.fy, config)
    return depth, sigma, fit_scale(network, samples, (depth.shape[0], depth.shape[1]), config)
