"""Meshes of plants that instances share."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_lab.simulator.appearance import palette
from ltm_lab.simulator.prototypes import Prototypes, _scatter


@pytest.mark.parametrize("seed", range(12))
def test_a_patch_has_a_plant_at_least(seed: int) -> None:
    points = _scatter(np.random.default_rng(seed), 6.0, 1.6, 1e-6)
    assert points.shape == (1, 2)
    assert np.abs(points).max() <= 3.0


@pytest.mark.parametrize("kind", ["chaparral_sparse", "scrub_sparse", "far_chaparral_sparse", "far_scrub_sparse"])
def test_sparse_patches_are_made_for_the_seed_that_drew_none(kind: str) -> None:
    seed = 77879  # of tower_ah, which could not be rendered
    assert all(len(variant.soup.triangles) > 0 for variant in Prototypes(palette(0.2, seed), seed)[kind])
