"""What terrain and network let expect of a photo's pixels, before any of them is decided (`topodepth`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ltm_core.depth.class_priors import ClassPriors
from ltm_core.depth.expected_surface import expected_surface
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ground_samples
from ltm_core.depth.guided_upsampling import NetworkView
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.occlusion_prior import OcclusionPrior
from ltm_core.depth.scale_fit import ScaleFit, fit_scale
from ltm_core.range_image import DepthImage, RangeImage
from ltm_core.types import Float32Array, UInt8Array


@dataclass(frozen=True)
class FusionSettings:
    """angle_sigma: of a camera's direction, radians, beside what its pose's covariance says. dem_sigma: of the
    terrain's heights, metres. label_columns: of the network that made the labels, whose edges are no finer; 0: they
    are the photo's own."""

    angle_sigma: float = float(np.radians(0.03))
    dem_sigma: float = 1.0
    label_columns: int = 0


class Expectation(NamedTuple):
    """What is known of a photo's pixels before any of them is decided: depth and sigma (H, W) that the terrain lets
    expect; the network's fit, its view of the photo, and what may stand before the ground, None without a network."""

    depth: Float32Array
    sigma: Float32Array
    fit: ScaleFit | None
    view: NetworkView | None
    standing: OcclusionPrior | None


def expect(
    traced: RangeImage | DepthImage,
    network: NetworkDepth | None,
    rgb: UInt8Array,
    labels: UInt8Array | None,
    classes: ClassPriors,
    settings: FusionSettings,
    config: FusionConfig,
) -> Expectation:
    """What `fuse` decides by; arguments as there."""
    if network is None:
        return Expectation(*_surface(traced, labels, classes, settings, config), None, None, None)
    expected, sigma, fit = fitted(traced, network, labels, classes, settings, config)
    if fit.trouble:
        return Expectation(expected, sigma, fit, None, None)
    view = NetworkView.of(fit, rgb, config)
    standing = OcclusionPrior.of(traced.depth(), labels, classes, traced.camera, traced.pose, view.shape, config)
    return Expectation(expected, sigma, fit, view, standing)


def _surface(
    traced: RangeImage | DepthImage,
    labels: UInt8Array | None,
    classes: ClassPriors,
    settings: FusionSettings,
    config: FusionConfig,
) -> tuple[Float32Array, Float32Array]:
    """What the terrain lets expect: bare ground, with the height of what grows there."""
    sigmas = settings.angle_sigma, settings.dem_sigma
    return expected_surface(traced.depth(), labels, classes.cover, traced.camera, traced.pose, *sigmas, config)


def fitted(
    traced: RangeImage | DepthImage,
    network: NetworkDepth,
    labels: UInt8Array | None,
    classes: ClassPriors,
    settings: FusionSettings,
    config: FusionConfig,
) -> tuple[Float32Array, Float32Array, ScaleFit]:
    """Pixel sampling and RANSAC regression: the network's scale from ground that can be trusted, and its errors there;
    with depth and sigma of the expected surface."""
    expected, sigma = _surface(traced, labels, classes, settings, config)
    samples = ground_samples(expected, sigma, labels, classes.ground, traced.camera.fy, config)
    return expected, sigma, fit_scale(network, samples, (expected.shape[0], expected.shape[1]), config)
