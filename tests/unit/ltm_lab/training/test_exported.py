from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.tiny_training import TINY, drawn_frame, with_steps

from ltm_core.base.errors import ConfigError
from ltm_core.vision.labels import Label, LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.training.config import NetworkConfig
from ltm_lab.training.training_frames import read_split


def test_the_terrain_teaches_depth_and_leaves_the_labels_alone(frames: Path, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.geometry.camera import Camera
    from ltm_core.vision.manifest import CoarseLook, NetworkManifest, Withdrawal
    from ltm_lab.training.adapt import AdaptConfig, adapted, depth_error, frame_of
    from ltm_lab.training.export import export, export_adapted, load_exported
    from ltm_lab.training.loop import train

    labels = LabelSet.load()
    torch.set_num_threads(1)  # so few steps of so small a network go elsewhere with every order of summation
    # Wide enough that the depth head, which nothing has taught yet, is not born dead behind its ReLUs.
    form = NetworkConfig(width=32, pretrained=False, fixed=0)
    look = CoarseLook(width=64, height=32, share=0.4)
    tiny = TINY.model_copy(
        update={"network": form, "heads_of": "taught", "coarse_look": look, "withdraw": Withdrawal(tree_contrast=6)}
    )
    start, _ = train(tiny, read_split(frames, tiny.split, 7), 7, lambda _: None)
    base = NetworkManifest.load(export(start, tiny, labels, tmp_path / "base"))
    assert base.heads_of == "taught"
    assert NetworkManifest.load(tmp_path / "base" / f"{tiny.name}_depth.yaml").heads_of == "taught_depth"
    network = load_exported(base)
    metres = np.array([np.inf, 30.0, 150.0, 900.0, 5000.0], np.float32)  # each class at a distance of its own
    views = [drawn_frame(seed) for seed in range(4)]
    posed = [frame_of(photo, metres[truth], f"north/{seed}.png", 96) for seed, (photo, truth) in enumerate(views)]
    assert posed[0].inverse is not None
    np.testing.assert_array_equal(np.isnan(posed[0].inverse), views[0][1] == Label.SKY)
    config = AdaptConfig(steps=80, learning_rate=0.01, width=96, height=64)
    before = depth_error(network, posed, config)
    taught = adapted(network, posed, config, lambda step, loss: None)
    assert depth_error(taught, posed, config) < 0.7 * before
    written = export_adapted(taught, base, "tiny_north", labels, tmp_path / "adapted", "adapted by a test")
    assert NetworkManifest.load(written).heads_of == "taught"
    assert base.coarse_look == NetworkManifest.load(written).coarse_look == look
    assert base.output.withdraw.tree_contrast == NetworkManifest.load(written).output.withdraw.tree_contrast == 6
    assert not NetworkManifest.load(tmp_path / "adapted" / "tiny_north_depth.yaml").heads_of
    photo, truth = drawn_frame(40)
    first, second = Segmenter(base).segment(photo), Segmenter.open(written).segment(photo)
    np.testing.assert_array_equal(first.labels, second.labels)
    depths = DepthNetwork.open(tmp_path / "adapted" / "tiny_north_depth.yaml").predict(
        photo, Camera.from_fov(96, 64, 50)
    )
    near, far = (np.median(depths.values[truth[2::4, 2::4] == label]) for label in (Label.GRASS, Label.BARE))
    assert near > 1.1 * far


def test_a_training_goes_on_from_an_exported_network(frames: Path, tmp_path: Path) -> None:
    """At its first step it gives the exported network's own labels; a checkpoint of it can be resumed."""
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_lab.training.export import export, load_exported
    from ltm_lab.training.loop import Run, score, train

    split, labels = read_split(frames, TINY.split, 7), LabelSet.load()
    first, _ = train(with_steps(TINY, 8), split, 7, lambda _: None)
    base = NetworkManifest.load(export(first, TINY, labels, tmp_path / "base"))
    weights = load_exported(base, fixed=1).state_dict()
    config = with_steps(TINY, 4)
    run = Run.start(config, 7, weights)
    before, after = (score(network, split.test, TINY, 7) for network in (first, run.network))
    assert np.abs(before.confusion - after.confusion).sum() < 0.01 * before.confusion.sum()
    network, run = train(config, split, 7, lambda _: None, run, tmp_path / "checkpoint.pt")
    assert run.losses[0] > 0
    resumed = Run.resume(tmp_path / "checkpoint.pt", config, 7)
    same = (torch.equal(a, b) for a, b in zip(resumed.network.parameters(), run.network.parameters(), strict=True))
    assert all(same)
    second = load_exported(NetworkManifest.load(export(network, TINY, labels, tmp_path / "next")))
    assert not torch.equal(second.classes.bias, weights["classes.bias"])
    wider = config.model_copy(update={"network": NetworkConfig(width=32, pretrained=False)})
    with pytest.raises(ConfigError, match=r"another network than configured.*width 32"):
        Run.start(wider, 7, weights)
