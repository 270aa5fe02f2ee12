import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes.networks import COLORS, changed, write_classifier
from typer.testing import CliRunner

from ltm_core.scoring.labels import CalibrationScore
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_lab.cli import main
from ltm_lab.training.finish import fit_temperature


def _frame(folder: Path, name: str, shift: int = 0) -> None:
    """Blue over lime with a red block; in the truth the skyline lies `shift` rows lower than the picture has it."""
    folder.mkdir(parents=True, exist_ok=True)
    photo = np.empty((128, 256, 3), np.uint8)
    photo[:] = COLORS["lime"]
    photo[:48] = COLORS["blue"]
    photo[80:112, 160:208] = COLORS["red"]
    truth = np.full((128, 256), Label.GRASS, np.uint8)
    truth[: 48 + shift] = Label.SKY
    truth[80:112, 160:208] = Label.BUILT
    truth[:, :16] = UNLABELLED
    cv2.imwrite(str(folder / f"{name}.png"), photo[..., ::-1])
    cv2.imwrite(str(folder / f"{name}_labels.png"), truth)


def test_scores_of_two_networks_are_those_of_their_answers(tmp_path: Path) -> None:
    _frame(tmp_path / "frames" / "near", "0001")
    _frame(tmp_path / "frames" / "low", "0001", shift=8)
    right = write_classifier(tmp_path, stride=1)
    blind = changed(right, name="blind", mapping={"blue": "sky"}).rename(tmp_path / "blind.yaml")
    right = write_classifier(tmp_path, stride=1)
    arguments = ["eval", "segmentation", str(tmp_path / "frames"), "--networks", f"{right},{blind}"]
    result = CliRunner().invoke(main.cli, [*arguments, "--json", str(tmp_path / "s.json")], env={"COLUMNS": "160"})
    assert result.exit_code == 0, result.output
    assert "skyline, median px of 512" in result.output
    scores = json.loads((tmp_path / "s.json").read_text())
    assert scores["conditions"]["threads"] == 1
    near, low = scores["near"], scores["low"]
    assert near["colors"]["sky_iou"] > 0.97
    assert near["colors"]["macro_f1"] > 0.97
    assert near["colors"]["skyline_median_px"] <= 2.0
    assert low["colors"]["skyline_median_px"] == pytest.approx(16.0, abs=2.0)  # 8 rows of 256 are 16 of 512
    assert low["colors"]["sky_iou"] == pytest.approx(48 / 56, abs=0.03)
    assert near["blind"]["f1"]["grass"] == 0.0
    assert near["blind"]["unlabelled"] == pytest.approx(80 / 128, abs=0.02)
    assert near["colors"]["f1"]["tree"] is None


def test_calibration_error_is_the_gap_between_confidence_and_right() -> None:
    truth = np.zeros((4, 25), np.uint8)
    found = truth.copy()
    found[0] = 1  # a quarter is wrong
    sure = np.full((4, 25), 255, np.uint8)
    score = CalibrationScore.empty().plus(truth, found, sure, 2)
    assert score.ece == pytest.approx(0.25)
    honest = CalibrationScore.empty().plus(truth, found, np.full((4, 25), 191, np.uint8), 2)
    assert honest.ece == pytest.approx(0.0, abs=2e-3)
    assert np.isnan(CalibrationScore.empty().ece)


def test_the_temperature_that_was_applied_is_found() -> None:
    rng = np.random.default_rng(8)
    logits = rng.normal(0.0, 2.0, (6000, 4)).astype(np.float32)
    weights = np.exp(logits / 2.5)
    edges = np.cumsum(weights / weights.sum(axis=1, keepdims=True), axis=1)
    labels = (rng.random((6000, 1)) > edges).sum(axis=1).astype(np.uint8)
    assert fit_temperature(logits, labels) == pytest.approx(2.5, rel=0.08)
