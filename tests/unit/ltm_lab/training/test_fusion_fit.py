from pathlib import Path

import numpy as np
import pytest
from scenes.depth_scene import depth_scene

from ltm_core.base.types import Float64Array
from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.labels import LabelSet
from ltm_lab.training.fusion_fit import CANOPY, STANDING, constants, fit_fusion, updated, write_fusion_config
from ltm_lab.training.fusion_samples import CLASSES, FrameSamples, Samples, frame_samples

TRUE = {"occlusion.standing.grass": -1.0, "occlusion.standing.tree": 1.5, "occlusion.metre": 0.3, "decision.heard": 0.7}


def drawn(weights: Float64Array, seed: int, count: int = 6000) -> Samples:
    """Answers are drawn with the odds that the weights give."""
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet(np.full(len(CLASSES), 0.3), count)
    height, against = rng.uniform(0, 20, count), rng.normal(0, 2, count)
    features = np.concatenate([shares, np.stack([-height, -against], axis=1)], axis=1)
    right = rng.random(count) < 1 / (1 + np.exp(-features @ weights))
    return Samples(features, np.zeros(count), right)


def nothing(columns: int) -> Samples:
    return Samples(np.empty((0, columns)), np.empty(0), np.empty(0, np.bool_))


def test_odds_that_made_the_samples_are_found_again() -> None:
    config = FusionConfig()
    values = {name: value for name, value, _, _ in constants(config)} | TRUE
    weights = np.array([values[name] for name in STANDING])
    folders = [[FrameSamples(drawn(weights, seed), nothing(len(CANOPY)))] for seed in (1, 2, 3)]
    fit = fit_fusion(folders, config)
    found = {name: value for name, value, _, _ in constants(fit.config)}
    for name in STANDING:
        # A class has few samples to itself: 18,000 tell its log odds to about 0.3.
        assert found[name] == pytest.approx(values[name], abs=0.7 if "standing" in name else 0.25), name
    before, after = fit.loss["standing"]
    assert after < before
    assert fit.counts == {"standing": 18_000, "canopy": 0}
    # What has no samples stays as it was.
    assert found["decision.canopy_weight"] == config.decision.canopy_weight


def test_constants_survive_their_file(tmp_path: Path) -> None:
    config = updated(FusionConfig(), {"occlusion.standing.tree": 1.25, "occlusion.metre": 0.2})
    write_fusion_config(tmp_path / "net_fusion.yaml", config, "a test")
    text = (tmp_path / "net_fusion.yaml").read_text()
    assert "a test" in text
    assert "# trees" in text
    assert "pose_check" not in text
    assert load_yaml(tmp_path / "net_fusion.yaml", FusionConfig) == config


def test_pixels_of_trees_that_the_dem_does_not_know_are_samples_of_what_stands() -> None:
    scene, labels, step = depth_scene(), LabelSet.load(), 2
    true = scene.truth[::step, ::step].astype(np.float32)
    samples = frame_samples(
        scene.traced, scene.network(), scene.photo, scene.labels, true, None, labels, FusionSettings(), FusionConfig()
    )
    assert samples is not None
    standing = samples.standing
    assert standing.features.shape == (len(standing.right), len(STANDING))
    assert len(standing.right) > 200
    assert len(samples.canopy.right) == 0
    shares = standing.features[:, : len(CLASSES)]
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-3)
    wooded = shares[:, CLASSES.index("tree")] > 0.9
    assert wooded.sum() > 100
    assert standing.right[wooded].mean() > 0.8
