"""`ltm-lab bench fusion`: processor time of fusing the traced and network depth of one frame, part by part.

The time of the depth network itself is not counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.depth.class_priors import ClassPriors
from ltm_core.depth.expected_surface import FusionSettings, expected_surface
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ground_samples
from ltm_core.depth.guided_upsampling import NetworkView
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.network_measurement import NetworkMeasurement
from ltm_core.depth.occlusion_boundaries import refine_occlusion_boundaries
from ltm_core.depth.occlusion_prior import DepthDiscontinuities, OcclusionPrior
from ltm_core.depth.pixel_fusion import fuse_pixels
from ltm_core.depth.pose_check import check_pose
from ltm_core.depth.scale_fit import fit_scale
from ltm_core.depth.topodepth import fuse
from ltm_core.depth.unseen_terrain import clear_unenclosed
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import DepthImage
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.holes import NOTHING_BEYOND
from ltm_core.vision.labels import LabelSet
from ltm_lab.bench.measure import Cost, least_cost
from ltm_lab.bench.mountains import ridged_terrain

NETWORK_SIZE = (256, 384)


@dataclass(frozen=True)
class FusionCost:
    """`part`: what was timed; `whole`: all of it, as a node does it."""

    part: str
    cost: Cost


@dataclass(frozen=True, eq=False)
class _Frame:
    traced: DepthImage
    photo: UInt8Array
    labels: UInt8Array
    network: NetworkDepth


def run(width: int = 1920, height: int = 1080, repeats: int = 5, extent: int = 2500) -> list[FusionCost]:
    """Costs for a frame of ridges, `extent` metres a side, under a patchwork of covers; the kernels are compiled
    before."""
    frame, classes, settings = _frame(width, height, extent), ClassPriors.of(LabelSet.load()), FusionSettings()
    config = FusionConfig()
    jump, sigmas = config.surface.jump, (settings.angle_sigma, settings.dem_sigma)
    camera, ground = frame.traced.camera, frame.traced.depth()
    surface, sigma = expected_surface(ground, frame.labels, classes.cover, camera, frame.traced.pose, *sigmas, config)
    samples = ground_samples(surface, sigma, frame.labels, classes.ground, camera.fy, config)
    fit = fit_scale(frame.network, samples, (height, width), config)
    seen, edges = NetworkView.of(fit, frame.photo, config), DepthDiscontinuities.of(ground, jump)
    standing = OcclusionPrior.of(ground, frame.labels, classes, camera, frame.traced.pose, seen.shape, config)

    def crests() -> None:
        surface, sigma = work
        of = classes, camera, config, seen, edges
        refine_occlusion_boundaries(frame.photo, ground, surface, sigma, frame.labels, *of)

    def decide() -> None:
        # From the same state each time: a copy's cost is in the figure.
        np.copyto(work[0], surface)
        np.copyto(work[1], sigma)
        fuse_pixels(work[0], work[1], None, seen, standing, frame.labels, classes, source, config)

    work, source = np.stack([surface, sigma]), np.empty(surface.shape, np.uint8)
    parts: dict[str, Callable[[], Any]] = {
        "traced edges": lambda: DepthDiscontinuities.of(ground, jump),
        "check of the pose": lambda: check_pose(
            frame.photo, ground, camera, *sigmas, config.pose_check, frame.labels, classes, edges=edges
        ),
        "expected surface": lambda: expected_surface(
            ground, frame.labels, classes.cover, camera, frame.traced.pose, *sigmas, config
        ),
        "sampling": lambda: ground_samples(surface, sigma, frame.labels, classes.ground, camera.fy, config),
        "RANSAC and regions": lambda: fit_scale(frame.network, samples, (height, width), config),
        "photo's edges for the network": lambda: NetworkView.of(fit, frame.photo, config),
        "what may stand there": lambda: OcclusionPrior.of(
            ground, frame.labels, classes, camera, frame.traced.pose, seen.shape, config
        ),
        "silhouettes": crests,
        "terrain or network": decide,
        "land beyond the raster": lambda: clear_unenclosed(ground, work[0], work[1], source),
        "the network's own measurement": lambda: NetworkMeasurement.of(fit, config),
        "whole": lambda: fuse(frame.traced, frame.network, frame.photo, frame.labels, classes, settings).measured(),
    }
    for call in parts.values():
        call()
    return [FusionCost(name, least_cost(call, repeats)) for name, call in parts.items()]


def _frame(width: int, height: int, extent: int) -> _Frame:
    dem = ridged_terrain(extent)
    camera = Camera.from_fov(width, height, 55.0)
    # A tower near the edge that looks along the site: three quarters of the photo are terrain, a tenth is land beyond
    # the raster, the rest sky.
    south = dem.elevation[-400:-50]
    row, col = np.unravel_index(int(np.argmax(south)), south.shape)
    x, y = dem.geometry.to_map(row + dem.geometry.height - 400, col)
    pose = Pose.from_angles((float(x), float(y), float(south[row, col]) + 10.0), 30.0, -12.0)
    depth = TerrainTracer(dem, possible=NOTHING_BEYOND).trace(camera, pose).depth()
    rng = np.random.default_rng(2)
    cover = cv2.resize(rng.integers(1, 5, (9, 16)).astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    labels = np.where(np.isinf(depth), 0, cover).astype(np.uint8)
    haze = np.exp(-np.where(np.isfinite(depth), depth, 1e5) / 1500.0)[..., None]
    color = np.array([[135, 190, 235], [200, 190, 110], [120, 110, 60], [40, 80, 40], [165, 150, 140]], np.float32)
    photo = color[labels] * haze + 210.0 * (1 - haze) + rng.normal(0, 6, (height, width, 1))
    inverse = np.where(np.isfinite(depth) & (depth > 0), 1 / np.maximum(depth, 1.0), 0.0).astype(np.float32)
    small = cv2.resize(inverse, NETWORK_SIZE[::-1], interpolation=cv2.INTER_AREA)
    values = (30 * small * (1 + 0.02 * rng.standard_normal(small.shape)) + 0.1).astype(np.float32)
    return _Frame(
        DepthImage(depth, camera, pose),
        np.clip(photo, 0, 255).astype(np.uint8),
        labels,
        NetworkDepth(values, "relative_inverse"),
    )
