"""Tests of what is built: coarser maps learn it from drawn structures, and no other score moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.tiny_training import TINY, drawn_frame

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.vision.labels import Label, LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.training.head_samples import PhotoSamples
from ltm_lab.training.labelled_frames import Frame, read_split
from ltm_lab.training.structure_cue import CueConfig, cue_samples, fit_cue

CHANNELS = {"last": 2, "s2": 1, "s1": 2}
CONFIG = CueConfig(draws=1)


def _photo(seed: int, built: int, bare: int, shown: tuple[float, float] = (1.0, -1.0)) -> PhotoSamples:
    """The network calls all of it bare; only the map `s2`, the third of five features, tells what is built."""
    rng = np.random.default_rng(seed)
    labels = np.repeat(np.array([Label.BUILT, Label.BARE], np.uint8), (built, bare))
    scores = np.full((built + bare, 7), -2.0)
    scores[:, Label.BARE] = 2.0
    features = rng.normal(0.0, 1.0, (built + bare, 5))
    features[:, 2] = np.repeat(shown, (built, bare)) + rng.normal(0.0, 0.1, built + bare)
    shares = np.zeros(7)
    shares[[Label.BUILT, Label.BARE]] = built / 1000, bare / 1000
    return PhotoSamples("a", labels, scores, features, shares)


def _odds(samples: PhotoSamples) -> Float64Array:
    """Of built against bare, by the cue fitted to other photos."""
    cue = fit_cue([_photo(1, 40, 90), _photo(2, 50, 110)], CHANNELS, CONFIG)
    said = samples.features[:, 2:3] @ cue.weights["s2"] + samples.features[:, 3:] @ cue.weights["s1"] + cue.bias
    return np.asarray(samples.scores[:, Label.BUILT] + said - samples.scores[:, Label.BARE], np.float64)


def test_the_map_that_tells_has_the_say_and_overrules_the_network() -> None:
    cue = fit_cue([_photo(1, 40, 90), _photo(2, 50, 110)], CHANNELS, CONFIG)
    assert {name: len(weights) for name, weights in cue.weights.items()} == {"s2": 1, "s1": 2}
    assert cue.weights["s2"][0] > 5 * np.abs(cue.weights["s1"]).max()
    other = _photo(7, 30, 70)
    np.testing.assert_array_equal(_odds(other) > 0, other.labels == Label.BUILT)


def test_a_photo_that_shows_nothing_built_gets_none() -> None:
    empty = _photo(9, 0, 60)
    assert (_odds(empty) < 0).all()
    with pytest.raises(ImageError, match="nothing else"):
        fit_cue([empty], CHANNELS, CONFIG)
    with pytest.raises(ImageError, match="nothing else"):
        fit_cue([], CHANNELS, CONFIG)


def test_copies_of_a_photo_bear_drawn_structures_and_the_photo_none() -> None:
    photo, labels = drawn_frame(4)
    frame = Frame(np.repeat(np.repeat(photo, 4, 0), 4, 1), np.repeat(np.repeat(labels, 4, 0), 4, 1), Path("oak.png"))
    plain, *drawn = cue_samples(Segmenter.open(), [frame], CueConfig(draws=6, pixels=20))
    assert not (plain.labels == Label.BUILT).any()
    assert sum((copy.labels == Label.BUILT).any() for copy in drawn) >= 4
    assert max(np.bincount(copy.labels).max() for copy in drawn) <= 20


def test_only_what_is_built_is_told_otherwise_in_the_exported_file(frames: Path, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from typer.testing import CliRunner

    from ltm_lab.cli.main import cli
    from ltm_lab.training.export import export
    from ltm_lab.training.exported import load_exported
    from ltm_lab.training.loop import Run, train

    torch.set_num_threads(1)
    start, _ = train(TINY, read_split(frames, TINY.split, 7), 7, lambda _: None)
    base = export(start, TINY, LabelSet.load(), tmp_path / "base")
    arguments = ["train", "built", str(base), "--photos", str(frames / "elm"), "--judged", str(frames / "oak")]
    done = CliRunner().invoke(cli, [*arguments, "--out", str(tmp_path / "out"), "--name", "taught", "--threads", "1"])
    assert done.exit_code == 0, done.output
    assert "F1 sky" in done.output
    before, after = Segmenter.open(base), Segmenter.open(tmp_path / "out" / "taught.yaml")
    photo: UInt8Array = drawn_frame(11)[0]
    was, now = before.scores_and_maps(photo), after.scores_and_maps(photo)
    np.testing.assert_array_equal(now[0][: Label.BUILT], was[0][: Label.BUILT])
    assert np.abs(now[0][Label.BUILT] - was[0][Label.BUILT]).max() > 0.1
    for name, values in was[1].items():
        np.testing.assert_array_equal(now[1][name], values)
    again = load_exported(after.manifest)
    assert again.side is not None
    rows = again.side["s2"].weight.detach().numpy()[:, :, 0, 0]
    assert np.abs(rows[Label.BUILT]).max() > 0
    assert not rows[: Label.BUILT].any()
    goes_on = Run.start(TINY, 7, again.state_dict())  # and so can training
    assert goes_on.network.side is not None
