"""Networks that go on from exported files: adapted to a site, with another's depth, trained further."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scenes.tiny_training import TINY, drawn_frame, with_steps

from ltm_core.base.errors import ConfigError
from ltm_core.vision.labels import Label, LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.training.config import NetworkConfig
from ltm_lab.training.labelled_frames import UNKNOWN, Frame, read_split

if TYPE_CHECKING:
    from ltm_lab.training.landscape_network import LandscapeNetwork


INVERSE = np.array([np.nan, 0.1, 0.01, 0.05, 0.003], np.float32)
"""1 / metres by label: what a drawn frame may stand for."""


def _error(network: LandscapeNetwork, seed: int) -> float:
    """Mean |log ratio| of a drawn frame's inverse depth to INVERSE, after its scale."""
    import torch

    from ltm_lab.training.depth_pyramid import land_depth_loss
    from ltm_lab.training.loop import normalised

    photo, ids = drawn_frame(seed)
    true = torch.from_numpy(np.log(INVERSE[ids][2::4, 2::4]))[None, None]
    known = torch.isfinite(true)
    with torch.inference_mode():
        return float(land_depth_loss(network(normalised([photo]))[1], torch.where(known, true, 0.0), known))


def test_the_terrain_teaches_depth_and_leaves_the_labels_alone(frames: Path, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.geometry.camera import Camera
    from ltm_core.vision.manifest import CoarseLook, NetworkManifest, Withdrawal
    from ltm_lab.training.adapt import AdaptConfig, adapted, depth_error, frame_of
    from ltm_lab.training.export import export, export_adapted
    from ltm_lab.training.exported import load_exported
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


def test_a_network_takes_on_anothers_depth_and_keeps_its_labels(frames: Path, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.geometry.camera import Camera
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_lab.training.depth_pyramid import DepthPyramidConfig, differences, joined, with_depth_of
    from ltm_lab.training.export import export, export_adapted
    from ltm_lab.training.exported import load_exported
    from ltm_lab.training.loop import Run, train

    labels, split = LabelSet.load(), read_split(frames, TINY.split, 7)
    torch.set_num_threads(1)
    tiny = with_steps(TINY, 6).model_copy(update={"network": NetworkConfig(width=32, pretrained=False, fixed=0)})
    first, _ = train(tiny, split, 7, lambda _: None)
    second, _ = train(tiny.model_copy(update={"seed": 9}), split, 7, lambda _: None)
    bases = [
        NetworkManifest.load(export(n, tiny, labels, tmp_path / name)) for n, name in ((first, "a"), (second, "b"))
    ]
    ours, theirs = (load_exported(base) for base in bases)
    photos = [drawn_frame(seed)[0] for seed in range(6)]
    config = DepthPyramidConfig(windows=24, steps=60, batch=3, learning_rate=0.005, average=0.5, width=96, height=64)
    told: list[tuple[int, float]] = []
    learnt = [Frame(photo, np.full(photo.shape[:2], UNKNOWN, np.uint8), Path("drawn")) for photo in photos[:4]]
    found = with_depth_of(ours, theirs, learnt, config, lambda done, loss: told.append((done, loss)))
    assert [done for done, _ in told] == list(range(1, 85))
    assert [bool(np.isfinite(loss)) for _, loss in told] == [False] * 24 + [True] * 60
    before, after = (differences(n, theirs, photos[4:], config).mean() for n in (joined(ours, theirs), found))
    assert after < 0.8 * before

    rendered = [replace(frame, inverse=INVERSE[drawn_frame(seed)[1]]) for seed, frame in enumerate(learnt)]
    longer = config.model_copy(update={"steps": 150, "learning_rate": 0.02, "truth": 5.0})
    helped = with_depth_of(ours, theirs, rendered, longer, lambda done, loss: None)
    assert _error(helped, 4) < 0.8 * _error(found, 4)
    order = [replace(frame, ordinal=True) for frame in rendered]
    alike = with_depth_of(ours, theirs, order, config, lambda done, loss: None)
    torch.testing.assert_close(alike.state_dict(), found.state_dict())

    written = export_adapted(found, bases[0], "both", labels, tmp_path / "c", "joined by a test")
    photo = photos[5]
    ids = [Segmenter(m).segment(photo).labels for m in (bases[0], NetworkManifest.load(written))]
    np.testing.assert_array_equal(*ids)
    again = load_exported(NetworkManifest.load(written))
    further = Run.start(tiny, 7, again.state_dict())
    torch.testing.assert_close(further.network.state_dict(), again.state_dict())
    before = differences(found, theirs, photos[4:], config)
    np.testing.assert_allclose(differences(joined(again, theirs), theirs, photos[4:], config), before, rtol=0.05)
    camera = Camera.from_fov(96, 64, 50.0)
    depth = DepthNetwork.open(tmp_path / "c" / "both_depth.yaml").predict(photo, camera).values
    other = DepthNetwork.open(tmp_path / "a" / f"{tiny.name}_depth.yaml").predict(photo, camera).values
    assert np.abs(np.log(depth / other) - np.log(depth / other).mean()).mean() > 0.001


def test_a_training_goes_on_from_an_exported_network(frames: Path, tmp_path: Path) -> None:
    """At its first step it gives the exported network's own labels; a checkpoint of it can be resumed."""
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_lab.training.export import export
    from ltm_lab.training.exported import blended, load_exported
    from ltm_lab.training.loop import Run, score, train

    split, labels = read_split(frames, TINY.split, 7), LabelSet.load()
    first, _ = train(with_steps(TINY, 8), split, 7, lambda _: None)
    base = NetworkManifest.load(export(first, TINY, labels, tmp_path / "base"))
    weights = load_exported(base, fixed=1).state_dict()
    config = with_steps(TINY, 4)
    run = Run.start(config, 7, weights)
    before, after = (score(network, split.test, TINY, 7) for network in (first, run.network))
    assert np.abs(before.confusion - after.confusion).sum() < 0.01 * before.confusion.sum()
    network, run = train(config, split, 7, lambda _: None, run, tmp_path / "checkpoint.pt", until=2)
    assert run.losses[0] > 0
    resumed = Run.resume(tmp_path / "checkpoint.pt", config, 7)
    same = (torch.equal(a, b) for a, b in zip(resumed.network.parameters(), run.network.parameters(), strict=True))
    assert all(same)
    second = load_exported(NetworkManifest.load(export(network, TINY, labels, tmp_path / "next")))
    mean = blended(load_exported(base), second, 0.25).classes.bias
    torch.testing.assert_close(mean, 0.75 * weights["classes.bias"] + 0.25 * second.classes.bias)
    assert not torch.equal(mean, second.classes.bias)
    wider = config.model_copy(update={"network": NetworkConfig(width=32, pretrained=False)})
    with pytest.raises(ConfigError, match=r"another network than configured.*width 32"):
        Run.start(wider, 7, weights)


def test_only_a_network_of_ours_can_be_adapted(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="training needs the extra `train`")
    from scenes.networks import write_classifier

    from ltm_core.base.errors import ModelError
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_lab.training.exported import load_exported

    with pytest.raises(ModelError, match=r"is not a network of `ltm train`"):
        load_exported(NetworkManifest.load(write_classifier(tmp_path)))
