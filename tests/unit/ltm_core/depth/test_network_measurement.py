from dataclasses import astuple

import cv2
import numpy as np
import pytest
from scenes.depth_scene import depth_scene

from ltm_core.base.types import BoolArray
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.topodepth import FusedDepth, Fusion, fuse
from ltm_core.vision.labels import Label, LabelSet

CLASSES = ClassPriors.of(LabelSet.load())
NEAR = 150.0


@pytest.fixture(scope="module")
def seen() -> tuple[FusedDepth, BoolArray]:
    """Fused, where a network sees ground at NEAR on a patch of far grass; and that patch, (h, w) of the network."""
    scene = depth_scene()
    values = scene.network(noise=0.05).values.copy()
    ground = scene.traced.depth()[2::4, 2::4]
    patch = np.zeros(ground.shape, np.bool_)
    patch[:, 40:60] = np.isfinite(ground[:, 40:60]) & (ground[:, 40:60] > 250)
    values[patch] = 40.0 / NEAR * (1 + 0.05 * np.random.default_rng(2).standard_normal(int(patch.sum()))) + 0.2
    labels = scene.labels.copy()
    labels[patch.repeat(4, 0).repeat(4, 1)] = Label.GRASS
    return fuse(scene.traced, NetworkDepth(values, "relative_inverse"), scene.photo, labels, CLASSES), patch


def test_it_tells_what_it_sees_where_the_terrain_says_otherwise(seen: tuple[FusedDepth, BoolArray]) -> None:
    fused, patch = seen
    inside = cv2.erode(patch.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    measured = fused.measured()
    off = np.abs(measured.depth - NEAR)[inside]
    assert inside.sum() > 200
    assert np.median(off) < 0.1 * NEAR
    assert (off < 2 * measured.sigma[inside]).mean() > 0.95
    # Fused depth believes the terrain in part, or at all.
    assert np.median(fused.depth[2::4, 2::4][inside]) > 1.4 * NEAR


def test_sky_and_what_is_as_good_as_unknown_are_no_measurement(seen: tuple[FusedDepth, BoolArray]) -> None:
    measured = seen[0].measured()
    sky = ~np.isfinite(seen[0].ground[2::4, 2::4])
    assert sky.any()
    assert np.isnan(measured.depth[sky]).mean() > 0.9
    known = np.isfinite(measured.depth)
    np.testing.assert_array_equal(known, np.isfinite(measured.sigma))
    assert (measured.sigma[known] < measured.depth[known]).all()


def test_without_a_network_that_fits_or_with_a_wrong_pose_nothing_is_measured() -> None:
    scene = depth_scene()
    noise = NetworkDepth(np.random.default_rng(1).random((54, 96)).astype(np.float32), "relative_inverse")
    cases = [(scene.traced, None), (scene.traced, noise), (scene.turned(2.0), scene.network())]
    for traced, network in cases:
        measured = fuse(traced, network, scene.photo, scene.labels, CLASSES).measured()
        assert np.isnan(measured.depth).all()
        assert np.isnan(measured.sigma).all()
    assert np.isfinite(fuse(scene.traced, scene.network(), scene.photo, None, CLASSES).measured().depth).any()


def test_without_fusing_it_is_the_same_to_the_bit() -> None:
    scene = depth_scene()
    noise = NetworkDepth(np.random.default_rng(1).random((54, 96)).astype(np.float32), "relative_inverse")
    hidden = np.zeros(scene.labels.shape, np.bool_)
    hidden[100:, :70] = True
    doubtful = np.zeros((9, 12), np.bool_)
    doubtful[7, 8:] = True
    given = scene.network(noise=0.05)
    for traced, network, labels, mask, unusable in (
        (scene.traced, given, scene.labels, None, ""),
        (scene.traced, given, None, hidden, ""),
        (scene.traced, given, scene.labels, hidden, ""),
        (scene.traced, given, scene.labels, None, "fog"),
        (scene.traced, noise, scene.labels, None, ""),
        (scene.traced, None, scene.labels, None, ""),
        (scene.turned(2.0), given, scene.labels, None, ""),
    ):
        photo = Fusion(traced, network, scene.photo, labels, CLASSES, hidden=mask, unusable=unusable)
        alone, fused = photo.outcome, photo.fused
        assert (alone.verdict, alone.reason) == (fused.verdict, fused.reason)
        for value, other in zip(*(astuple(made.measured(doubtful)) for made in (alone, fused)), strict=True):
            np.testing.assert_array_equal(value, other)
