from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from scenes.tiny_training import COLORS, TINY, drawn_frame, with_steps, write_drawn

from ltm_core.base.errors import ConfigError
from ltm_core.label_heads.labelled_frames import LAND, UNKNOWN
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.training.augment import augmented
from ltm_lab.training.config import AugmentConfig, OptimiserConfig, SplitConfig
from ltm_lab.training.statements import rows_of
from ltm_lab.training.training_frames import TrainingFrame, read_split, read_training_frames

if TYPE_CHECKING:
    from ltm_lab.training.loop import Progress


def test_frames_are_read_as_rendered(frames: Path) -> None:
    read = read_training_frames(frames / "elm", 7)
    assert [frame.path.name for frame in read] == ["0010.png", "0011.png", "0012.png"]
    image, labels = drawn_frame(11)
    np.testing.assert_array_equal(read[1].image, image)
    np.testing.assert_array_equal(read[1].labels, labels)


def test_no_scenario_is_in_two_parts(frames: Path) -> None:
    split = read_split(frames, SplitConfig(validation=("elm",), test=("oak",)), 7)
    parts = [{frame.path.parent.name for frame in part} for part in (split.train, split.validation, split.test)]
    assert parts == [{"ash", "fir"}, {"elm"}, {"oak"}]
    assert len(split.train) == 6


def test_augmentation_repeats_with_its_seed_and_keeps_labels_on_their_pixels() -> None:
    """With geometry alone the photo's colours still tell each pixel's class."""
    image, labels = drawn_frame(5)
    inverse = (labels + 1).astype(np.float32)
    frame = TrainingFrame(image, labels, Path("oak/0005.png"), inverse)
    geometry = AugmentConfig(**{**dict.fromkeys(AugmentConfig.model_fields, 0.0), "flip": 0.5, "rescale": 0.7})
    for seed in range(6):
        photo, truth, depth = augmented(frame, (72, 80), geometry, np.random.default_rng(seed))
        again = augmented(frame, (72, 80), geometry, np.random.default_rng(seed))
        for one, other in zip((photo, truth, depth), again, strict=True):
            np.testing.assert_array_equal(one, other)
        assert photo.shape == (72, 80, 3)
        distance = np.abs(photo[:, :, None].astype(int) - COLORS.astype(int)).sum(axis=-1)
        known = truth != UNKNOWN
        assert known.mean() > 0.5
        np.testing.assert_array_equal(depth[known], truth[known] + 1.0)
        assert np.isnan(depth[~known]).all()
        assert (distance.argmin(axis=-1) == truth)[known].mean() > 0.85


def test_a_short_training_gives_a_calibrated_model_of_unseen_frames(frames: Path, tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_core.fuel.label_errors import find_record
    from ltm_lab.training.curve_io import write_curve
    from ltm_lab.training.export import export
    from ltm_lab.training.finish import calibrate, score_sets
    from ltm_lab.training.loop import train

    labels = LabelSet.load()
    split = read_split(frames, TINY.split, len(labels))
    seen: list[Progress] = []
    network, run = train(TINY, split, len(labels), seen.append)
    assert [progress.step for progress in seen if progress.validation] == [15, 30]
    assert run.best == max(progress.best for progress in seen)
    write_curve(tmp_path / "curve.png", "tiny", run)
    assert cv2.imread(str(tmp_path / "curve.png")).std() > 5
    manifest = export(network, TINY, labels, tmp_path / "model")
    temperature, _ = calibrate(manifest, split.validation, labels, 0)
    segmenter = Segmenter.open(manifest)
    assert segmenter.manifest.output.temperature == pytest.approx(temperature, abs=1e-4)
    score = score_sets(segmenter, split.test)["oak"]
    assert score.labels.accuracy > 0.5
    assert score.labels.iou[Label.SKY] > 0.8
    record = find_record(segmenter.manifest)
    assert record is not None
    assert record.errors().measured


def break_off_at(step: int) -> "Callable[[Progress], None]":
    """Interrupt a training after this step."""

    def report(progress: "Progress") -> None:
        if progress.step == step:
            raise KeyboardInterrupt

    return report


def test_a_training_repeats_and_goes_on_from_its_checkpoint(frames: Path, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_lab.training.loop import Run, train

    config = with_steps(TINY, 4)
    config = config.model_copy(update={"optimiser": config.optimiser.model_copy(update={"validate_every": 2})})
    split = read_split(frames, config.split, 7)
    checkpoint = tmp_path / "checkpoint.pt"
    whole, _ = train(config, split, 7, lambda _: None)
    with pytest.raises(KeyboardInterrupt):
        train(config, split, 7, break_off_at(2), checkpoint=checkpoint)
    run = Run.resume(checkpoint, config, 7)
    assert run.step == 2
    resumed, _ = train(config, split, 7, lambda _: None, run)
    first, second = whole.state_dict(), resumed.state_dict()
    assert all(torch.equal(first[name], second[name]) for name in first)
    with pytest.raises(ConfigError, match=r"other values of seed"):
        Run.resume(checkpoint, config.model_copy(update={"seed": 9}), 7)


def test_depth_is_learnt_but_for_its_scale() -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_lab.training.losses import Batch, depth_loss, order_loss

    rng = np.random.default_rng(2)
    truth = np.exp(rng.normal(0.0, 0.01, (1, 24, 40))).cumsum(axis=1).astype(np.float32)
    truth[:, :5] = np.nan

    def batch(ordinal: bool) -> Batch:
        labels = torch.full((1, 24, 40), UNKNOWN, dtype=torch.uint8)
        return Batch(torch.zeros(1, 3, 24, 40), labels, torch.from_numpy(truth), torch.tensor([ordinal]))

    right = torch.from_numpy(np.log(np.nan_to_num(truth, nan=1.0)))[None]
    assert float(depth_loss(right + 3.0, batch(False))) == pytest.approx(0.0, abs=1e-5)
    assert float(depth_loss(right * 0.5, batch(False))) > 0.05
    assert float(depth_loss(right, batch(True))) == 0.0  # an order says nothing of ratios
    assert float(order_loss(right, batch(True))) < float(order_loss(-right, batch(True)))
    assert float(order_loss(right, batch(False))) == 0.0


def test_partial_knowledge_rules_out_what_cannot_be() -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_lab.training.losses import class_loss

    def loss(label: int, predicted: int) -> float:
        logits = torch.zeros(1, 7, 4, 6)
        logits[:, predicted] = 8.0
        labels = torch.full((1, 4, 6), label, dtype=torch.uint8)
        return float(class_loss(logits, labels, torch.ones(7), OptimiserConfig()))

    assert loss(LAND, Label.WATER) > 1.0 > 0.1 > loss(LAND, Label.TREE)
    assert loss(UNLABELLED, Label.SKY) > 1.0 > 0.1 > loss(UNLABELLED, Label.WATER)
    assert loss(UNKNOWN, Label.SKY) == 0.0
    (no_shrub,) = set(rows_of("shrub built", 9).tolist())
    assert loss(no_shrub, Label.SHRUB) > 1.0 > 0.1 > loss(no_shrub, Label.TREE)
    with pytest.raises(ConfigError, match="shrubs"):
        rows_of("water shrubs", 9)


def test_teachers_split_a_slope_by_a_persons_word() -> None:
    """Sky above a slope whose left half is snow and whose right half is dark; grass below."""
    from ltm_lab.training.photo_sets import Opinions, teach

    photo = np.full((60, 90, 3), 40, np.uint8)
    photo[:20] = (150, 190, 240)
    photo[20:45, :40] = 230
    planes = {name: np.full((60, 90), 0.02, np.float32) for name in ("sky", "scene", "slope", "grass")}
    planes["sky"][:20] = planes["scene"][:20] = 0.98
    planes["slope"][20:45] = planes["grass"][45:] = 0.95
    opinions = Opinions(planes["sky"], planes["scene"], planes["slope"], {Label.GRASS: planes["grass"]})
    labels = teach(photo, opinions, "BT")
    assert set(np.unique(labels[:20])) == {Label.SKY}
    assert set(np.unique(labels[47:])) == {Label.GRASS}
    assert np.mean(labels[22:43, :36] == Label.BARE) > 0.9
    assert np.mean(labels[22:43, 50:] == Label.TREE) > 0.9
    assert np.all(teach(photo, opinions)[22:43] == LAND)
    planes["scene"][5:10] = 0.0  # the scene network denies sky that the other sees, far from the skyline
    assert np.all(teach(photo, opinions, "BT")[5:10] == UNKNOWN)
    with pytest.raises(ConfigError, match=r"tag 'XY'"):
        teach(photo, opinions, "XY")


def test_simulated_frames_bring_their_depth(tmp_path: Path) -> None:
    """Range is along the ray, depth along the axis: the ratio is the ray's cosine."""
    import json

    from ltm_core.geometry.camera import Camera

    camera = Camera.from_fov(96, 64, 60.0)
    write_drawn(tmp_path, 3)
    ranges = np.full((64, 96), 250.0, np.float32)
    ranges[:20] = np.inf
    np.savez(tmp_path / "0003_truth.npz", range_surface=ranges)
    fields = ("width", "height", "fx", "fy", "cx", "cy", "distortion")
    entry = {"image": "0003.png", "truth_camera": {name: getattr(camera, name) for name in fields}}
    (tmp_path / "frames.json").write_text(json.dumps({"frames": [entry]}))
    (frame,) = read_training_frames(tmp_path, 7)
    assert frame.inverse is not None
    assert not frame.ordinal
    assert np.isnan(frame.inverse[:20]).all()
    np.testing.assert_allclose(frame.inverse[40, 90], 1.0 / (250.0 * camera.rays()[40, 90, 2]), rtol=1e-6)


def test_labels_are_kept_where_nothing_is_known() -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra `train`")
    from ltm_lab.training.losses import kept_labels_loss

    before = torch.zeros(1, 2, 1, 2)
    logits = torch.tensor([[[[np.log(3.0), 9.0]], [[0.0, 0.0]]]])  # 3:1 where unknown, another where it is known
    labels = torch.tensor([[[UNKNOWN, 0]]], dtype=torch.uint8)
    assert float(kept_labels_loss(logits, before, labels)) == pytest.approx(0.5 * np.log(4 / 3))
    assert float(kept_labels_loss(logits, before, torch.zeros_like(labels))) == 0.0
