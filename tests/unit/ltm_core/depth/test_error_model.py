import numpy as np
import pytest
from scenes.called import called
from scenes.depth_scene import CAMERA, depth_scene

from ltm_core.base.types import Float64Array
from ltm_core.depth.error_model import estimate_errors, expected_prediction
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors, GroundSamples, ground_samples
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.scale_fit import fit_scale
from ltm_core.vision.labels import LabelSet

CLASSES, CONFIG = ClassPriors.of(LabelSet.load()), FusionConfig()
SIZE = (360, 640)


def spread_samples(count: int = 4000, seed: int = 2) -> GroundSamples:
    rng = np.random.default_rng(seed)
    depth = np.exp(rng.uniform(np.log(40.0), np.log(4000.0), count))
    rows, cols = rng.integers(0, SIZE[0], count), rng.integers(0, SIZE[1], count)
    return GroundSamples(rows, cols, depth, 0.005 * depth)


def misread(depth: Float64Array) -> Float64Array:
    """Inverse depth of a network for which all beyond 1000 m is at 500 m."""
    return 1.0 / np.where(depth > 1000.0, 500.0, depth)


def test_a_slow_error_of_depth_is_learnt_and_is_no_noise() -> None:
    samples = spread_samples()
    noise = 1 + 0.05 * np.random.default_rng(5).standard_normal(len(samples))
    answers = estimate_errors(misread(samples.depth) * noise, samples, SIZE, CONFIG)
    for depth in (60.0, 200.0, 1600.0):
        less, sigma = called(expected_prediction)(np.float32(1 / depth), answers)
        assert 1 / depth - less == pytest.approx(float(misread(np.array(depth))), rel=0.08)
        assert sigma < 0.35 / (depth if depth < 1000 else 500.0)


def test_what_hides_most_of_the_far_ground_is_no_error_of_the_network() -> None:
    """A block at 250 m stands before 55 in 100 samples beyond 360 m; the network is right everywhere."""
    samples = spread_samples()
    rng = np.random.default_rng(9)
    hidden = (samples.depth > 360.0) & (rng.random(len(samples)) < 0.55)
    seen = np.where(hidden, 250.0, samples.depth) * (1 + 0.01 * rng.standard_normal(len(samples)))
    answers = estimate_errors(1.0 / seen, samples, SIZE, CONFIG)
    for depth in (400.0, 1000.0, 3000.0):
        less, sigma = called(expected_prediction)(np.float32(1 / depth), answers)
        assert abs(less) * depth < 0.05
        assert sigma * depth < 0.1


def test_a_shift_needs_evidence() -> None:
    """Ground of one range only cannot tell a shift; a network of true inverse depths keeps its 0 at infinity."""
    scene = depth_scene()
    rng = np.random.default_rng(4)
    ground = scene.traced.depth()
    inverse = np.where(np.isfinite(ground), 1.0 / ground, 0.0)[2::4, 2::4]
    noisy = (7.0 * inverse * np.exp(0.25 * rng.standard_normal(inverse.shape))).astype(np.float32)
    sigma = np.full_like(ground, 1.0)
    some = np.where((ground > 150) & (ground < 400), ground, np.nan).astype(np.float32)
    samples = ground_samples(some, sigma, None, CLASSES.ground, CAMERA.fy, CONFIG)
    fit = fit_scale(NetworkDepth(noisy, "relative_inverse"), samples, SIZE, CONFIG)
    assert fit.trouble == ""
    assert fit.line is not None
    assert fit.line.shift == 0.0
    assert fit.line.scale == pytest.approx(1 / 7.0, rel=0.1)
