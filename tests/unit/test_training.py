"""Training of the segmentation network: frames and splits, augmentation, and a short run to a working model."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from ltm_core.errors import ConfigError, ImageError, RecordingError
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_core.vision.train.augment import OUTSIDE, augmented, fractal_noise
from ltm_core.vision.train.config import AugmentConfig, NetworkConfig, OptimiserConfig, SplitConfig, TrainingConfig
from ltm_core.vision.train.frames import read_frames, read_split

SIZE = (64, 96)
COLORS = np.array([(140, 190, 235), (200, 190, 90), (110, 90, 50), (20, 70, 30), (160, 150, 140)], np.uint8)


def _frame(seed: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Sky over patches of grass, shrub, tree and bare ground, each in its own colour."""
    rng = np.random.default_rng(seed)
    labels = (1 + np.minimum(fractal_noise(SIZE, rng, octaves=2) * 4, 3)).astype(np.uint8)
    labels[: int(rng.integers(15, 35))] = Label.SKY
    noise = rng.normal(0.0, 5.0, (*SIZE, 3))
    return np.clip(COLORS[labels] + noise, 0, 255).astype(np.uint8), labels


def _write(folder: Path, seed: int, labels: NDArray[np.uint8] | None = None) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    image, truth = _frame(seed)
    cv2.imwrite(str(folder / f"{seed:04d}.png"), image[..., ::-1])
    cv2.imwrite(str(folder / f"{seed:04d}_labels.png"), truth if labels is None else labels)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    for index, scenario in enumerate(["ash", "elm", "fir", "oak"]):
        for number in range(3):
            _write(tmp_path / "frames" / scenario, 10 * index + number)
    return tmp_path / "frames"


def test_frames_are_read_as_rendered(frames: Path) -> None:
    read = read_frames(frames / "elm", 7)
    assert [frame.path.name for frame in read] == ["0010.png", "0011.png", "0012.png"]
    image, labels = _frame(11)
    np.testing.assert_array_equal(read[1].image, image)
    np.testing.assert_array_equal(read[1].labels, labels)


def test_no_scenario_is_in_two_parts(frames: Path) -> None:
    split = read_split(frames, SplitConfig(validation=("elm",), test=("oak",)), 7)
    parts = [{frame.path.parent.name for frame in part} for part in (split.train, split.validation, split.test)]
    assert parts == [{"ash", "fir"}, {"elm"}, {"oak"}]
    assert len(split.train) == 6


def test_a_held_out_scenario_must_be_there(frames: Path) -> None:
    with pytest.raises(RecordingError, match=r"no scenario yew.*ash, elm, fir, oak"):
        read_split(frames, SplitConfig(validation=("yew",), test=("oak",)), 7)


def test_a_scenario_in_validation_and_test_is_refused() -> None:
    with pytest.raises(ValueError, match=r"elm is in validation and in test"):
        SplitConfig(validation=("elm",), test=("oak", "elm"))


def test_labels_of_another_size_or_unknown_id_are_refused(tmp_path: Path) -> None:
    _write(tmp_path / "small", 1, np.zeros((64, 95), np.uint8))
    with pytest.raises(ImageError, match=r"0001_labels\.png: is \(64, 95\) uint8, expected \(64, 96\)"):
        read_frames(tmp_path / "small", 7)
    _write(tmp_path / "unknown", 2, np.full(SIZE, 7, np.uint8))
    with pytest.raises(ImageError, match=r"holds label 7, expected ids below 7 or 255"):
        read_frames(tmp_path / "unknown", 7)


def test_sampled_labels_can_score_but_not_train(tmp_path: Path) -> None:
    truth = _frame(4)[1]
    _write(tmp_path / "frames", 4, truth[::4, ::4])
    (frame,) = read_frames(tmp_path / "frames", 7, sampled=True)
    np.testing.assert_array_equal(frame.labels[::4, ::4], truth[::4, ::4])
    assert np.sum(frame.labels != UNLABELLED) == 16 * 24
    with pytest.raises(ImageError, match=r"\(16, 24\) uint8, expected \(64, 96\)"):
        read_frames(tmp_path / "frames", 7)


def test_a_folder_without_frames_says_what_it_expects(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"NNNN_labels\.png"):
        read_frames(tmp_path, 7)


def test_augmentation_repeats_with_its_seed_and_keeps_labels_on_their_pixels() -> None:
    """With geometry alone the photo's colours still tell each pixel's class."""
    image, labels = _frame(5)
    geometry = AugmentConfig(new_sky=0, ground_tint=0, snow=0, haze=0, light=0, grey=0, blur=0, noise=0, jpeg=0)
    for seed in range(6):
        photo, truth = augmented(image, labels, (72, 80), geometry, np.random.default_rng(seed))
        again = augmented(image, labels, (72, 80), geometry, np.random.default_rng(seed))
        np.testing.assert_array_equal(photo, again[0])
        np.testing.assert_array_equal(truth, again[1])
        assert photo.shape == (72, 80, 3)
        distance = np.abs(photo[:, :, None].astype(int) - COLORS.astype(int)).sum(axis=-1)
        known = truth != OUTSIDE
        assert known.mean() > 0.5
        assert (distance.argmin(axis=-1) == truth)[known].mean() > 0.85


def test_every_augmentation_gives_a_photo_and_leaves_labels_be() -> None:
    image, labels = _frame(6)
    every = AugmentConfig(**dict.fromkeys(AugmentConfig.model_fields, 1.0))
    none = AugmentConfig(**dict.fromkeys(AugmentConfig.model_fields, 0.0))
    photo, truth = augmented(image, labels, SIZE, none, np.random.default_rng(0))
    np.testing.assert_array_equal(photo, image)
    np.testing.assert_array_equal(truth, labels)
    for seed in range(8):
        photo, truth = augmented(image, labels, SIZE, every, np.random.default_rng(seed))
        assert photo.dtype == np.uint8
        assert photo.std() > 1.0
        assert set(np.unique(truth)) <= {*np.unique(labels), OUTSIDE}


def test_a_short_training_repeats_and_its_model_labels_unseen_frames(frames: Path, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_core.vision.evaluate import score_segmenter
    from ltm_core.vision.train.export import export
    from ltm_core.vision.train.loop import Progress, train

    labels = LabelSet.load()
    config = TrainingConfig(
        name="tiny",
        width=96,
        height=64,
        seed=3,
        split=SplitConfig(validation=("elm",), test=("oak",)),
        network=NetworkConfig(widths=(8, 12, 16, 16, 16), repeats=(1, 1, 1, 1), expansion=2, decoder=16),
        optimiser=OptimiserConfig(steps=40, batch=4, validate_every=20, learning_rate=0.01, average=0.8),
        augment=AugmentConfig(new_sky=0, ground_tint=0, snow=0, haze=0, light=0, grey=0, noise=0.5, jpeg=0),
    )
    split = read_split(frames, config.split, len(labels))
    seen: list[Progress] = []
    network, validation = train(config, split, len(labels), seen.append)
    assert [progress.step for progress in seen if progress.validation] == [20, 40]
    assert validation.mean_iou == max(progress.best for progress in seen)
    short = config.model_copy(update={"optimiser": config.optimiser.model_copy(update={"steps": 3})})
    first, second = (train(short, split, len(labels), lambda _: None)[0].state_dict() for _ in range(2))
    assert all(torch.equal(first[name], second[name]) for name in first)
    segmenter = Segmenter.open(export(network, config, labels, tmp_path / "model"))
    score = score_segmenter(segmenter, ((frame.image, frame.labels) for frame in split.test))
    assert score.accuracy > 0.6
    assert score.iou[Label.SKY] > 0.8


def test_an_unknown_training_key_is_named(tmp_path: Path) -> None:
    from ltm_core.config_io import load_yaml

    path = tmp_path / "t.yaml"
    path.write_text("name: t\nsplit: {validation: [a], test: [b]}\noptimiser: {lerning_rate: 1}\n")
    with pytest.raises(ConfigError, match=r"optimiser\.lerning_rate: unknown key"):
        load_yaml(path, TrainingConfig)
